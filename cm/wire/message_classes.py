# SPDX-License-Identifier: Apache-2.0
"""Protobuf's classes of our messages, made without its implementation in pure Python.

Modules that protoc writes import that beside the one in C: 20 modules and 1.1 MiB of each process. What is imported
here instead lies below it and does the same since protobuf 4.21; where it is missing, protoc's way is taken.
"""

from __future__ import annotations

from typing import Any

from google.protobuf.descriptor import FileDescriptor
from google.protobuf.internal import api_implementation
from google.protobuf.message import Message


def define(name: str, package: str, serialized: bytes, module: dict[str, Any]) -> None:
    """Put the messages and enumerations of a file into `module`, as protoc's code would.

    `name` and `package` are the file's, `serialized` is its FileDescriptorProto.
    """
    try:
        if api_implementation.Type() == "python":
            raise ImportError("nothing is below it")
        from google.protobuf.internal.enum_type_wrapper import EnumTypeWrapper
        from google.protobuf.pyext.cpp_message import GeneratedProtocolMessageType  # type: ignore[import-not-found]
    except ImportError:
        _define_as_protoc(serialized, module)
        return
    file = FileDescriptor(name, package, serialized_pb=serialized)

    def made(message: Any, outer: str = "") -> Any:
        path = outer + message.name
        known = {inner.name: made(inner, f"{path}.") for inner in message.nested_types}
        known |= {"DESCRIPTOR": message, "__module__": module["__name__"], "__qualname__": path}
        return GeneratedProtocolMessageType(message.name, (Message,), known)

    module["DESCRIPTOR"] = file
    for enum in file.enum_types_by_name.values():
        module[enum.name] = EnumTypeWrapper(enum)
        module.update((value.name, value.number) for value in enum.values)
    module.update((message.name, made(message)) for message in file.message_types_by_name.values())


def _define_as_protoc(serialized: bytes, module: dict[str, Any]) -> None:
    from google.protobuf import descriptor_pool
    from google.protobuf.internal import builder

    file = module["DESCRIPTOR"] = descriptor_pool.Default().AddSerializedFile(serialized)
    builder.BuildMessageAndEnumDescriptors(file, module)
    builder.BuildTopDescriptorsAndMessages(file, module["__name__"], module)
