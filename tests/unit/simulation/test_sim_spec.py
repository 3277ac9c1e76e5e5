# SPDX-License-Identifier: Apache-2.0
"""What hardware a board has for a given schema."""

from __future__ import annotations

import itertools
import resource

import pytest

from cm import schema
from cm.simulation.software import BoardSpec, SimError
from cm.simulation.software.hardware.fabric import Fabric

LISTING_1 = """\
config:
  - name: camera
  - modules: [default,edge,colorise]
  - type: partial
  - modes:
    edge_detection:
      - modules: [edge]
      - mmio:
        - base_address: 0x2000
        - registers:
          - focus:
            - offset: 0x1010
            - default: 0x01
        - overlay:
          - camera
    default:
      - modules: [default]
      - overlay:
        - camera
"""


def spec(*texts: str) -> BoardSpec:
    return BoardSpec.from_configs(schema.loads(text) for text in texts)


def small(name: str, rest: str) -> str:
    return f"config:\n  name: {name}\n  modules: [m]\n  modes: {{default: {{modules: [m]}}}}\n{rest}"


def test_listing_1_makes_a_board_with_a_region_a_window_a_camera_and_a_loop():
    board = spec(LISTING_1)
    assert board.device.name == "xc7z020"
    assert list(board.regions) == ["prr0"]
    assert [(w.name, w.address, w.size) for w in board.windows] == [("prr0", 0x2000, 0x2000)]
    assert {name: (c.region, c.partner, c.is_camera) for name, c in board.channels.items()} == {
        "camera": ("prr0", None, True),
        "to_pl": ("prr0", "from_pl", False),
        "from_pl": ("prr0", "to_pl", False),
    }


def test_regions_without_a_footprint_get_frames_that_do_not_overlap():
    text = "config:\n  name: two\n  regions: {a: {}, b: {}}\n  modules: {m: {region: a}, n: {region: b}}\n"
    board = spec(text + "  modes: {default: {modules: [m, n]}}\n")
    taken = [
        (frames.block_type, frames.row, column)
        for region in board.regions.values()
        for frames in region.footprint
        for column in range(frames.column_first, frames.column_last + 1)
    ]
    assert len(taken) == len(set(taken))
    assert all(region.footprint for region in board.regions.values())


def test_windows_that_would_overlap_are_apart_or_one():
    mmio = """\
  mmio:
    - {base_address: 0x1000, registers: {a: {offset: 0x0}}}
    - {base_address: 0x2000, registers: {b: {offset: 0x1800}}}
    - {base_address: 0x5000, registers: {c: {offset: 0x0}}}
    - {base_address: 0x8000, registers: {d: {offset: 0x2004}}}
    - {base_address: 0xa000, registers: {e: {offset: 0x0}}}
"""
    windows = spec(small("w", mmio)).windows
    assert all(one.end <= two.address for one, two in itertools.pairwise(windows))
    for address in (0x1000, 0x3800, 0x5000, 0xA004, 0xA000):
        assert any(window.address <= address < window.end for window in windows)


def test_a_window_may_be_large_and_takes_memory_where_it_is_used():
    board = spec(small("w", "  mmio: [{base_address: 0x10000000, registers: {far: {offset: 0x7ffffffc}}}]\n"))
    assert board.windows[0].size == 1 << 31
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    Fabric(board)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # KiB


def test_configurations_for_different_devices_are_refused():
    with pytest.raises(SimError, match="one device"):
        spec(small("a", "  device: xc7z020\n"), small("b", "  device: xc7z010\n"))


def test_an_unknown_device_is_refused_with_a_list_of_the_known_ones():
    with pytest.raises(SimError, match="xc7z020"):
        spec(small("a", "  device: zx81\n"))


def test_no_configuration_makes_no_board():
    with pytest.raises(SimError, match="no configuration"):
        spec()


def test_configurations_share_a_board():
    board = spec(LISTING_1, small("other", "  mmio: [{base_address: 0x40000000, registers: {x: {offset: 4}}}]\n"))
    assert [window.address for window in board.windows] == [0x2000, 0x40000000]
    assert {module.config for module in board.modules} == {"camera", "other"}


def test_a_memory_to_stream_channel_alone_is_a_sink():
    streams = "  streams: {out: {direction: mm2s, shape: [4, 4]}}\n"
    channel = spec(small("s", streams)).channels["out"]
    assert channel.partner is None
    assert not channel.is_camera


def test_channels_are_paired_within_their_region():
    streams = """\
  streams:
    camera: {direction: s2mm, region: prr0}
    to_a: {direction: mm2s, region: prr0}
    from_a: {direction: s2mm, region: prr0}
    to_b: {direction: mm2s, region: prr1}
    from_b: {direction: s2mm, region: prr1}
"""
    text = "config:\n  name: two\n  regions: {prr0: {}, prr1: {}}\n  modules: {m: {region: prr0}}\n"
    board = spec(text + "  modes: {default: {modules: [m]}}\n" + streams)
    assert {name: channel.partner for name, channel in board.channels.items()} == {
        "camera": None, "to_a": "from_a", "from_a": "to_a", "to_b": "from_b", "from_b": "to_b",
    }  # fmt: skip


def test_what_a_mode_has_in_the_static_part_is_there_with_one_region_too():
    text = """
    config:
      name: one
      modules: {edge: {}}
      modes:
        default:
          modules: [edge]
          mmio:
            - {base_address: 0x1000, region: static, registers: {led: {offset: 0x0}}}
            - {base_address: 0x2000, registers: {gain: {offset: 0x0}}}
    """
    spec = BoardSpec.from_configs([schema.loads(text)])
    assert {register.name: register.region for register in spec.registers} == {"led": None, "gain": "prr0"}
