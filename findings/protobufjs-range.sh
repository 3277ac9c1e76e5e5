#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: a number that does not fit its field is refused by protobufjs, by verify() at least, as it is in Python.
# Seen: verify() passes it, and what goes is another number: 2^32 + 5 goes as 5; -1 as 2^32 - 1 in a uint32, as 0 in a
# uint64. fromObject() takes a word that is none of the enum's, and sends the first. @bufbuild/protobuf and Python refuse
# all of these.
. "$(dirname "$0")/setup"
debian protobuf-compiler libprotoc32 libprotobuf32
pypi protobuf==7.36.2
npm install --silent --no-fund --no-audit protobufjs@7.6.6 @bufbuild/protobuf@2.17.0
cat >write.proto <<'END'
syntax = "proto3";
message Write { uint32 value = 1; int32 step = 2; uint64 wide = 3; Mode mode = 4; }
enum Mode { IDLE = 0; FULL = 1; }
END
protoc --descriptor_set_out=write.bin write.proto
cat >tried.mjs <<'END'
import { readFileSync } from "node:fs";
import { createFileRegistry, create, fromBinary, fromJson, toBinary } from "@bufbuild/protobuf";
import { FileDescriptorSetSchema } from "@bufbuild/protobuf/wkt";
import protobuf from "protobufjs";

const tried = [{ value: 2 ** 32 + 5 }, { value: -1 }, { step: 2 ** 31 }, { wide: -1 }, { mode: "FUL" }];
const Write = (await protobuf.load("write.proto")).lookupType("Write");
const schema = createFileRegistry(fromBinary(FileDescriptorSetSchema, readFileSync("write.bin"))).getMessage("Write");
const sent = (one) => Write.toObject(Write.decode(one), { longs: String, enums: String, defaults: true });
const refused = (act) => { try { act(); return false; } catch { return true; } };
const seen = tried.map((one) => {
	const [name, value] = Object.entries(one)[0];
	return [Write.verify(one), sent(Write.encode(Write.fromObject(one)).finish())[name],
		refused(() => toBinary(schema, typeof value === "string" ? fromJson(schema, one) : create(schema, one)))];
});
console.log(JSON.stringify(seen));
END
SEEN=$(node tried.mjs) python3 - <<'END'
import json
import os

from google.protobuf import descriptor_pb2, message_factory
from saw import saw

files = descriptor_pb2.FileDescriptorSet.FromString(open("write.bin", "rb").read())
Write = message_factory.GetMessages(files.file)["Write"]
before = {
    ("value", 2**32 + 5): (None, 5),
    ("value", -1): (None, 2**32 - 1),
    ("step", 2**31): (None, -(2**31)),
    ("wide", -1): (None, "0"),
    ("mode", "FUL"): ("mode: enum value expected", "IDLE"),
}
for (said, sent, refused), ((name, value), old) in zip(json.loads(os.environ["SEEN"]), before.items()):
    try:
        Write(**{name: value})
        python = False
    except ValueError:
        python = True
    saw(f"{name} = {value}: verify() says, what goes", (said, sent), old)
    saw("refused by @bufbuild/protobuf, by Python", (refused, python), (True, True))
END
