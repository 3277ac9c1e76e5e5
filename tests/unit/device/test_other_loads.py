# SPDX-License-Identifier: Apache-2.0
"""What other programs load through the kernel is noticed, and what we load ourselves is not taken for it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from cm.device import Root
from cm.device.other_loads import OtherLoads, Seen

MANAGERS, OVERLAYS = "sys/class/fpga_manager", "sys/kernel/config/device-tree/overlays"


@pytest.fixture
def others(tmp_path: Path) -> Iterator[OtherLoads]:
    manager(tmp_path, "fpga0")
    overlay(tmp_path, "before", b"firmware-name")
    made = OtherLoads(Root.of(tmp_path))
    made.begin()
    yield made
    made.close()
    made.close()


def manager(root: Path, name: str) -> None:
    (root / MANAGERS / name).mkdir(parents=True)
    for file, text in (("state", "operating\n"), ("flags", "0\n"), ("firmware", "")):
        (root / MANAGERS / name / file).write_text(text)


def overlay(root: Path, name: str, dtbo: bytes = b"", status: str = "applied", path: str = "") -> None:
    folder = root / OVERLAYS / name
    folder.mkdir(parents=True)
    for file, data in (("dtbo", dtbo), ("status", status.encode()), ("path", path.encode())):
        (folder / file).write_bytes(data)


def load(root: Path, name: str = "fpga0") -> None:
    """As fpgautil does it."""
    for file, text in (("flags", "0"), ("firmware", "other.bin")):
        with (root / MANAGERS / name / file).open("r+") as attribute:
            attribute.write(text)


def test_an_image_that_another_program_loads_is_seen_once(others: OtherLoads, tmp_path: Path) -> None:
    assert others.look(()) == Seen()
    load(tmp_path)
    load(tmp_path)
    assert others.look(()).loads == ("fpga0 was told to load an image (it says 'operating')",)
    assert others.look(()) == Seen()
    (tmp_path / MANAGERS / "fpga0/state").read_text()
    (tmp_path / MANAGERS / "fpga0/flags").write_text("1")
    assert others.look(()) == Seen(), "nothing was loaded"
    with others.ours():
        load(tmp_path)
    assert others.look(()) == Seen(), "it was ours"
    load(tmp_path)
    with others.ours():
        load(tmp_path)
    assert others.look(()).loads == ("fpga0 was told to load an image (it says 'operating')",), "before ours"


def test_a_port_that_came_with_an_overlay_is_watched_too(others: OtherLoads, tmp_path: Path) -> None:
    manager(tmp_path, "fpga1")
    assert others.look(()) == Seen()
    load(tmp_path, "fpga1")
    assert others.look(()).loads == ("fpga1 was told to load an image (it says 'operating')",)


@pytest.mark.parametrize(
    ("dtbo", "path", "loads"),
    [
        (b"\xd0\x0d..firmware-name..", "", True),
        (b"\xd0\x0d..compatible..", "", False),
        (b"", "app/app.dtbo", True),
        (b"", "app/plain.dtbo", False),
        (b"", "app/gone.dtbo", True),
    ],
    ids=["loads", "loads nothing", "a file that loads", "a file that loads nothing", "unknown"],
)
def test_an_overlay_that_another_program_applies_is_seen_if_it_may_load(
    others: OtherLoads, tmp_path: Path, dtbo: bytes, path: str, loads: bool
) -> None:
    firmware = tmp_path / "lib/firmware/app"
    firmware.mkdir(parents=True)
    (firmware / "app.dtbo").write_bytes(b"firmware-name")
    (firmware / "plain.dtbo").write_bytes(b"compatible")
    overlay(tmp_path, "theirs", dtbo, "unapplied", path)
    overlay(tmp_path, "ours", b"firmware-name")
    assert others.look(("ours",)) == Seen(), "not applied yet"
    (tmp_path / OVERLAYS / "theirs/status").write_text("applied\n")
    said = ("overlay theirs was applied, which loads one",) if loads else ()
    assert others.look(("ours",)) == Seen(said)
    assert others.look(("ours",)) == Seen()


def test_an_overlay_of_ours_that_another_program_removes_is_missed(others: OtherLoads, tmp_path: Path) -> None:
    assert others.look(("before", "ours")) == Seen(removed=("ours",))


def test_a_board_without_ports_and_overlays_has_nothing_to_watch(tmp_path: Path) -> None:
    bare = OtherLoads(Root.of(tmp_path))
    bare.begin()
    assert bare.look(()) == Seen()
    assert bare.who() == ""


def test_who_may_have_done_it_is_told_with_what_ends_it(others: OtherLoads, tmp_path: Path) -> None:
    (tmp_path / "proc/77").mkdir(parents=True)
    (tmp_path / "proc/77/comm").write_text("dfx-mgrd\n")
    assert others.who() == ("dfx-mgrd runs (pid 77; xmutil unloadapp; systemctl disable --now dfx-mgr dfx-mgr-fw-load)")
