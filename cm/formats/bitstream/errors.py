# SPDX-License-Identifier: Apache-2.0
"""Why a bitstream is refused: one class and one stable code for each reason."""

from __future__ import annotations

from cm.errors import CmError


class BitstreamError(CmError, ValueError):
    """Base of all refusals of a bitstream."""

    code = "bitstream_refused"


class BadContainer(BitstreamError):
    """The file is not a .bit, .bin or boot image, or its header contradicts its length."""

    code = "bitstream_container"


class Truncated(BitstreamError):
    """The file ends inside its header, inside a packet, or before DESYNC."""

    code = "bitstream_truncated"


class NoSync(BitstreamError):
    """There is no sync word, so nothing in the file would reach the configuration logic."""

    code = "no_sync"


class BadPacket(BitstreamError):
    """Words that are not a configuration packet, or a packet that is not allowed in a bitstream."""

    code = "bitstream_packet"


class CrcMismatch(BitstreamError):
    """A CRC in the stream is not that of the words before it."""

    code = "crc_mismatch"


class CrcMissing(BitstreamError):
    """A stream that carries CRCs has register writes that none of them covers."""

    code = "crc_missing"


class FramesIncomplete(BitstreamError):
    """Frame data is not a whole number of frames, or there is none."""

    code = "frames_incomplete"


class CannotRelocate(BitstreamError):
    """The other region is not the same in columns or static part; the sentence names the first difference."""

    code = "cannot_relocate"


class UnknownDevice(BitstreamError):
    """No IDCODE, or one of a device whose frames are not known."""

    code = "unknown_device"


class WrongDevice(BitstreamError):
    """The bitstream was built for another device."""

    code = "wrong_device"


class WrongStatic(BitstreamError):
    """The bitstream was made with a static design other than the expected one."""

    code = "wrong_static"


class NotPartial(BitstreamError):
    """A full bitstream was given where a partial one is needed."""

    code = "not_partial"


class NotFull(BitstreamError):
    """A partial bitstream was given where a full one is needed."""

    code = "not_full"


class FootprintOutside(BitstreamError):
    """The bitstream writes frames that the region does not own."""

    code = "footprint_outside"


class Sha256Mismatch(BitstreamError):
    """The file is not the one that was recorded."""

    code = "sha256_mismatch"


class Encrypted(BitstreamError):
    """The bitstream is encrypted, and the region does not permit that."""

    code = "encrypted"


def errors_by_code() -> dict[str, type[BitstreamError]]:
    """Return every refusal by its code."""
    return {cls.code: cls for cls in [BitstreamError, *BitstreamError.__subclasses__()]}
