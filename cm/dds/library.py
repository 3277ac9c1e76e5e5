# SPDX-License-Identifier: Apache-2.0
"""The functions of libddsc that make a sample from pieces of memory, with one copy where the Python API makes two.

They are not a public interface, so each library is tried before it is used (`proved`): if it is not the expected one,
`Library.open` returns None, and samples go through the Python API.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

from cffi import FFI

_TRIED = ("11.0.",)  # versions of cyclonedds whose library has these functions so
_SDK_DATA = 2  # enum ddsi_serdata_kind
_DECLARATIONS = """
typedef int32_t dds_entity_t;
struct iov { void *base; size_t length; };
int32_t dds_get_entity_sertype(dds_entity_t entity, void **sertype);
void *ddsi_serdata_from_ser_iov(void *sertype, int kind, size_t count, const struct iov *pieces, size_t size);
uint32_t ddsi_serdata_size(void *serdata);
void ddsi_serdata_to_ser(void *serdata, size_t offset, size_t size, void *buffer);
void ddsi_serdata_unref(void *serdata);
int32_t dds_writecdr(dds_entity_t writer, void *serdata);
struct info {
    uint32_t sample_state, view_state, instance_state;
    _Bool valid_data;
    int64_t source_timestamp;
    uint64_t instance_handle, publication_handle;
    uint32_t disposed_generations, no_writers_generations, sample_rank, generation_rank, absolute_generation_rank;
};
int32_t dds_takecdr(dds_entity_t reader, void **serdata, uint32_t most, struct info *info, uint32_t mask);
"""
_ANY_STATE = 0x7F  # DDS_ANY_STATE


class Library:
    """The libddsc that cyclonedds itself runs on. Its wheel contains two; the other one would not know our entities."""

    def __init__(self, path: str) -> None:
        self.ffi = FFI()
        self.ffi.cdef(_DECLARATIONS)
        self.dds: Any = self.ffi.dlopen(path)

    @classmethod
    def open(cls) -> Library | None:
        """None if this version of cyclonedds has not been tried, or lacks one of the functions."""
        if not version("cyclonedds").startswith(_TRIED):
            return None
        from cyclonedds.__library__ import library_path

        try:
            found = cls(str(library_path))
            _ = found.dds.ddsi_serdata_from_ser_iov, found.dds.ddsi_serdata_to_ser, found.dds.dds_writecdr
        except (OSError, AttributeError):
            return None
        return found

    def pieces(self, entity: int) -> Pieces:
        """Samples for a writer. Raises OSError if it has no type."""
        return Pieces(self, entity)

    def taken(self, reader: int) -> Iterator[Taken]:
        """The samples that are there, each to be used before the next."""
        found = self.ffi.new("void **")
        info: Any = self.ffi.new("struct info *")
        while self.dds.dds_takecdr(reader, found, 1, info, _ANY_STATE) == 1:
            try:
                if info.valid_data:
                    yield Taken(self, found[0])
            finally:
                self.dds.ddsi_serdata_unref(found[0])


class Taken:
    """A sample as DDS holds it."""

    def __init__(self, library: Library, serdata: Any) -> None:
        self._ffi, self._dds, self._serdata = library.ffi, library.dds, serdata
        self.size = int(self._dds.ddsi_serdata_size(serdata))

    def start(self, length: int) -> bytes:
        """Its first bytes, `length` at most."""
        length = min(length, self.size)
        out = self._ffi.new("char[]", length)
        self._dds.ddsi_serdata_to_ser(self._serdata, 0, length, out)
        return bytes(self._ffi.buffer(out))

    def copy(self, offset: int, address: int, length: int) -> None:
        """Copy a piece to where it is needed: the only copy. Raises ValueError if there is less."""
        if offset + length > self.size:
            raise ValueError(f"{offset + length} bytes are wanted of a sample of {self.size}")
        self._dds.ddsi_serdata_to_ser(self._serdata, offset, length, self._ffi.cast("void *", address))


class Pieces:
    """Samples of one writer, made from a head and what follows it, each copied once."""

    def __init__(self, library: Library, entity: int) -> None:
        self._ffi, self._dds, self._entity = library.ffi, library.dds, entity
        out = self._ffi.new("void **")
        if self._dds.dds_get_entity_sertype(entity, out) != 0:
            raise OSError("this writer of cyclonedds has no type")
        self._type = out[0]
        self._zeros = self._ffi.new("char[4]")
        self._iov = self._ffi.new("struct iov[3]")

    def write(self, head: bytearray, rows: Any, length: int) -> None:
        """`rows`: addresses and lengths of what follows, `length` bytes in all. Raises OSError."""
        sample = self._made(head, rows, length)
        if self._dds.dds_writecdr(self._entity, sample) < 0:  # which then owns the sample
            raise OSError("DDS did not take the sample")

    def _made(self, head: bytearray, rows: Any, length: int) -> Any:
        count = len(rows) + 2
        if count > len(self._iov):
            self._iov = self._ffi.new("struct iov[]", count)
        iov, pad = self._iov, -(len(head) + length) % 4
        start = self._ffi.from_buffer(head)
        iov[0].base, iov[0].length = start, len(head)
        for number, (address, size) in enumerate(rows, 1):
            iov[number].base, iov[number].length = self._ffi.cast("void *", address), size
        iov[count - 1].base, iov[count - 1].length = self._zeros, pad
        total = len(head) + length + pad
        sample = self._dds.ddsi_serdata_from_ser_iov(self._type, _SDK_DATA, count if pad else count - 1, iov, total)
        if sample == self._ffi.NULL:
            raise OSError("DDS made no sample of these bytes")
        return sample

    def proved(self, sample: bytes) -> bool:
        """Whether a sample made from pieces holds the very bytes; nothing is sent."""
        head, body = bytearray(sample[:8]), ctypes.create_string_buffer(sample[8:], len(sample) - 8)
        address = ctypes.addressof(body)
        half = (len(sample) - 8) // 2
        made = self._made(head, [(address, half), (address + half, len(sample) - 8 - half)], len(sample) - 8)
        try:
            size = self._dds.ddsi_serdata_size(made)
            if size != len(sample) + -len(sample) % 4:
                return False
            back = self._ffi.new("char[]", size)
            self._dds.ddsi_serdata_to_ser(made, 0, size, back)
            held = bytes(self._ffi.buffer(back))
        finally:
            self._dds.ddsi_serdata_unref(made)
        return held[:2] == sample[:2] and held[4 : len(sample)] == sample[4:]  # between them stands how much is padding
