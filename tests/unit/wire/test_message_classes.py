# SPDX-License-Identifier: Apache-2.0
"""The classes of our messages are protobuf's own, whichever of its implementations there is."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from google.protobuf import descriptor_pool
from google.protobuf.internal import api_implementation

from cm.wire import cm_pb2 as pb

PURE = "google.protobuf.internal.python_message"
PROGRAM = f"""
import sys
from cm.wire import cm_pb2 as pb
print({PURE!r} in sys.modules)
value, status = pb.RegValue(fields={{"gain": 3}}), pb.Status(mode="edge")
status.streams.add(name="camera")
print(value.SerializeToString(deterministic=True).hex(), status.SerializeToString().hex(), pb.PR_MODE_FULL)
print(pb.RegValue.FromString(value.SerializeToString()).fields["gain"], type(status).__module__, str(status).split())
"""


def output(**environment: str) -> list[str]:
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=os.environ | environment, stdout=-1, check=True)
    return done.stdout.decode().splitlines()


@pytest.mark.skipif(api_implementation.Type() == "python", reason="protobuf is here in Python only")
def test_the_implementation_in_pure_python_is_imported_only_where_there_is_no_other() -> None:
    fast, pure = output(), output(PROTOCOL_BUFFERS_PYTHON_IMPLEMENTATION="python")
    assert (fast[0], pure[0]) == ("False", "True")
    assert fast[1:] == pure[1:]


def test_they_are_those_of_the_pool() -> None:
    file = descriptor_pool.Default().FindFileByName("cm/wire/cm.proto")
    assert file is pb.DESCRIPTOR
    for name, message in file.message_types_by_name.items():
        assert getattr(pb, name).DESCRIPTOR is message
    assert pb.RegValue.FieldsEntry.__qualname__ == "RegValue.FieldsEntry"
    assert pb.PrMode.Value("PR_MODE_FULL") == pb.PR_MODE_FULL
