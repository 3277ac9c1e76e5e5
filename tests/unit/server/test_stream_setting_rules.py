# SPDX-License-Identifier: Apache-2.0
"""The settings that a stream may be given, and how a channel applies them: no device, no socket."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from cm.device import Direction as ChannelDirection
from cm.device import DmaCaps, DmaInfo, DmaType
from cm.errors import InvalidRequest
from cm.schema.model import Direction, Stream
from cm.server.streams import channel_setup
from cm.server.streams.channel_setup import changed, frame_bytes
from cm.wire.messages.requests import ConfigureStream

READ = Stream("camera", "ch0", Direction.S2MM, shape=(480, 640))
WRITE = Stream("to_pl", "ch1", Direction.MM2S, shape=(480, 640))
BOTH = DmaCaps.CYCLIC | DmaCaps.VIDEO


def channel(**given: Any) -> DmaInfo:
    usual = DmaInfo("ch0", ChannelDirection.S2MM, DmaType.AXIDMA, BOTH | DmaCaps.RESIDUE, 4, 1 << 26, 1, 0)
    return replace(usual, **given) if hasattr(usual, "__dataclass_fields__") else usual._replace(**given)


# ---- requests --------------------------------------------------------------------------------------


def test_a_request_changes_what_it_names_and_nothing_else() -> None:
    assert changed(READ, ConfigureStream("camera")) == READ
    wanted = changed(
        READ, ConfigureStream("camera", (8, 4), dtype="uint16", slots=3, rate=5.0, backpressure=True, stride=16)
    )
    assert wanted == replace(READ, shape=(8, 4), dtype="uint16", slots=3, limit=5.0, backpressure=True, stride=16)
    assert changed(wanted, ConfigureStream("camera")) == wanted
    assert changed(wanted, ConfigureStream("camera", backpressure=False)).backpressure is False
    assert changed(WRITE, ConfigureStream("to_pl", cyclic=True)).cyclic is True


def test_an_endless_rate_lifts_the_limit() -> None:
    limited = replace(READ, limit=5.0)
    assert changed(limited, ConfigureStream("camera", rate=float("inf"))).limit is None
    assert changed(limited, ConfigureStream("camera")).limit == 5.0


def test_the_direction_may_be_given_if_it_is_right() -> None:
    assert changed(READ, ConfigureStream("camera", direction="S2MM")) == READ
    with pytest.raises(InvalidRequest, match="is s2mm, not 'mm2s'"):
        changed(READ, ConfigureStream("camera", direction="mm2s"))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"rate": -0.5}, "-0.5 frames per second; a limit is positive"),
        ({"rate": float("nan")}, "nan frames per second"),
        ({"slots": 257}, "257 slots; 1 to 256 can be had"),
        ({"slots": -1}, "-1 slots"),
        ({"cyclic": True}, "cannot be cyclic: only a written frame is repeated"),
        ({"shape": (0, 4)}, r"no frame has the shape \(0, 4\)"),
        ({"shape": (1,) * 9}, "1 to 8 extents"),
        ({"shape": (1 << 15, 1 << 15, 2)}, "more than 1 GiB"),
        ({"dtype": "float77"}, "no dtype 'float77'; there are bool, int8, uint8, .*, complex128"),
        ({"dtype": "<u2"}, "no dtype '<u2'"),  # frames are little-endian
        ({"stride": 639}, "lines of 640 bytes do not fit a stride of 639; give a stride of 640"),
        ({"shape": (640,), "stride": 640}, "has a stride, but no shape of lines and columns"),
        ({"stride": 1 << 23}, "480 lines with a stride of 8388608 take more than 2 GiB"),
    ],
)
def test_settings_that_no_channel_supports_are_refused(given: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidRequest, match=words) as refused:
        changed(READ, ConfigureStream("camera", **given))
    assert str(refused.value).startswith("stream 'camera'")


def test_pixels_keep_their_form() -> None:
    pictures = replace(READ, shape=(480, 640, 2), format="yuv422")
    assert changed(pictures, ConfigureStream("camera", (8, 4))).shape == (8, 4, 2)
    with pytest.raises(
        InvalidRequest, match=r"^stream 'camera': pixels of yuv422 share .* in pairs, and a line has 5$"
    ):
        changed(pictures, ConfigureStream("camera", (8, 5)))


@pytest.mark.parametrize(
    "given", [{"slots": 256}, {"shape": (1 << 15, 1 << 15)}, {"shape": (1,) * 8}, {"stride": 640}, {"rate": 0.01}]
)
def test_settings_just_within_the_limits_are_accepted(given: dict[str, Any]) -> None:
    wanted = changed(READ, ConfigureStream("camera", **given))
    assert wanted != READ


def test_a_frame_without_a_shape_has_no_length() -> None:
    assert frame_bytes(replace(READ, shape=None)) == 0
    assert frame_bytes(replace(READ, shape=None, dtype="uint16")) == 0
    assert frame_bytes(replace(READ, shape=(3, 5), dtype="complex64")) == 120


# ---- channels ----------------------------------------------------------------------------------------


def test_a_frame_of_an_axi_dma_is_one_transfer() -> None:
    made = channel_setup.setup(channel(), replace(READ, limit=4.0, backpressure=True))
    assert (made.write, made.length, made.backpressure, made.cyclic) == (False, 480 * 640, True, False)
    assert (made.lines, made.line_bytes, made.stride) == (0, 0, 0)
    assert made.period_ns == 250_000_000
    assert channel_setup.setup(channel(), READ).period_ns == 0
    assert channel_setup.setup(channel(), WRITE).write


def test_lines_that_lie_apart_are_a_video_frame() -> None:
    made = channel_setup.setup(channel(), replace(READ, stride=1024))
    assert (made.lines, made.line_bytes, made.stride) == (480, 640, 1024)
    assert made.length == 479 * 1024 + 640
    with pytest.raises(InvalidRequest, match="has a stride, but channel ch0 knows no lines"):
        channel_setup.setup(channel(caps=DmaCaps.RESIDUE), replace(READ, stride=1024))
    assert channel_setup.setup(channel(caps=DmaCaps.RESIDUE), replace(READ, stride=640)).lines == 0


def test_every_frame_of_a_vdma_is_a_video_frame() -> None:
    vdma = channel(type=DmaType.VDMA, caps=DmaCaps.VIDEO)
    made = channel_setup.setup(vdma, READ)
    assert (made.lines, made.line_bytes, made.stride, made.length) == (480, 640, 640, 480 * 640)
    for shape in (None, (640,)):
        with pytest.raises(InvalidRequest, match="channel ch0 is a VDMA's: its frames have a shape of lines"):
            channel_setup.setup(vdma, replace(READ, shape=shape))


def test_a_written_frame_is_repeated_if_the_channel_can() -> None:
    cyclic = replace(WRITE, cyclic=True)
    assert channel_setup.setup(channel(), cyclic).cyclic
    assert channel_setup.setup(channel(caps=DmaCaps.VIDEO), replace(cyclic, stride=1024)).cyclic  # a frame repeats
    assert not channel_setup.setup(channel(), replace(READ, cyclic=True)).cyclic
    with pytest.raises(InvalidRequest, match="cannot be cyclic: channel ch0 cannot repeat a transfer"):
        channel_setup.setup(channel(caps=DmaCaps.VIDEO), cyclic)


def test_a_channel_that_cannot_tell_lengths_needs_a_shape() -> None:
    blind = channel(caps=BOTH)
    assert channel_setup.setup(blind, READ).length == 480 * 640
    assert channel_setup.setup(blind, replace(WRITE, shape=None)).write
    assert channel_setup.setup(channel(caps=BOTH, frame_length=100), replace(READ, shape=None)).length == 100
    told = "how many bytes arrived: give the stream the shape of its frames, each of which must end with TLAST"
    with pytest.raises(InvalidRequest, match=told):
        channel_setup.setup(blind, replace(READ, shape=None))


def test_a_slot_without_a_known_length_is_a_mebibyte_or_what_the_channel_moves() -> None:
    flat = replace(READ, shape=None)
    assert channel_setup.setup(channel(), flat).length == 1 << 20
    assert channel_setup.setup(channel(max_length=4096), flat).length == 4096
    assert channel_setup.setup(channel(frame_length=2048), flat).length == 2048


def test_a_frame_longer_than_the_length_register_is_refused_with_the_width_that_it_needs() -> None:
    assert channel_setup.setup(channel(max_length=480 * 640), READ).length == 480 * 640
    # what the schema says of the engine counts too, where the channel would do more, as a simulated one
    with pytest.raises(InvalidRequest, match="a frame has 307200 bytes, channel ch0 moves 16383 at most"):
        channel_setup.setup(channel(), replace(READ, max_length=16383))
    assert channel_setup.longest(channel(max_length=100), replace(READ, max_length=200)) == 100
    with pytest.raises(InvalidRequest) as refused:
        channel_setup.setup(channel(max_length=480 * 640 - 1), READ)
    assert str(refused.value) == (
        "stream 'camera': a frame has 307200 bytes, channel ch0 moves 307199 at most; "
        "its design would need a 'Width of Buffer Length Register' of 19 bits or more"
    )
    with pytest.raises(InvalidRequest) as refused:
        channel_setup.setup(channel(max_length=639), replace(READ, stride=1024))
    assert "a line has 640 bytes, channel ch0 moves 639 at most" in str(refused.value)
    with pytest.raises(InvalidRequest) as refused:
        channel_setup.setup(channel(max_length=639, type=DmaType.VDMA, caps=DmaCaps.VIDEO), READ)
    assert str(refused.value).endswith("639 at most")
    with pytest.raises(InvalidRequest) as refused:
        channel_setup.setup(channel(), replace(READ, shape=(1 << 27,)))
    assert str(refused.value).endswith("at most"), "no register is that wide"


def test_what_is_not_a_multiple_of_the_alignment_is_refused() -> None:
    assert channel_setup.setup(channel(alignment=4), READ).length == 480 * 640
    assert channel_setup.setup(channel(alignment=0), replace(READ, shape=(3,))).length == 3
    with pytest.raises(InvalidRequest, match="frames of 6 bytes; channel ch0 takes multiples of 4"):
        channel_setup.setup(channel(alignment=4), replace(READ, shape=(6,)))
    with pytest.raises(InvalidRequest, match="lines of 6 bytes; channel ch0 takes multiples of 4"):
        channel_setup.setup(channel(alignment=4), replace(READ, shape=(2, 6), stride=8))
    with pytest.raises(InvalidRequest, match="a stride of 10 bytes; channel ch0 takes multiples of 4"):
        channel_setup.setup(channel(alignment=4), replace(READ, shape=(2, 8), stride=10))
