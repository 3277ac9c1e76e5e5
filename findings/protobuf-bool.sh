#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: True may be assigned to an integer field, as bool is an int of Python; at most a new generator is needed.
# Seen: code made by protoc 3.21 of 2022 is imported by all three runtimes, but the value that 5.29 takes, and of which
# 6.33 warns, is an error in 7.36.
. "$(dirname "$0")/setup"
debian protobuf-compiler libprotoc32 libprotobuf32
echo 'syntax = "proto3"; message Write { uint32 value = 1; repeated int64 many = 2; bool flag = 3; }' >write.proto
protoc --python_out=. write.proto
cat >tried.py <<'END'
import sys
import warnings

import google.protobuf
from saw import saw
from write_pb2 import Write

with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    try:
        kept = Write(value=True, many=[False]).value
    except TypeError as error:
        kept = str(error)
saw(google.protobuf.__version__, (kept, [one.category.__name__ for one in told][:1]), eval(sys.argv[1]))
saw("an integer for a bool", Write(flag=1).flag, True)
END
for pair in "5.29.5=(1, [])" "6.33.0=(1, ['DeprecationWarning'])" "7.36.2=('Field Write.value: Expected an int, got a boolean.', [])"; do
	rm -rf venv
	pypi "protobuf==${pair%%=*}"
	venv/bin/python tried.py "${pair#*=}"
done
