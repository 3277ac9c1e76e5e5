# SPDX-License-Identifier: Apache-2.0
"""Which files configure a device identically, whatever their container and padding; and those that overlays name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from bitstream_support import HERE, frames, small, two_sections

from cm.formats import fdt
from cm.formats.bitstream import Container, Expectation, FrameAddress, FrameRun, assemble, convert
from cm.formats.bitstream.errors import BitstreamError, Sha256Mismatch
from cm.manager.errors import BadOverlay
from cm.manager.inputs import Image
from cm.schema import loads
from cm.schema.model import Overlay
from cm.server.bitstream_and_overlay_files import BitstreamReader, BoardFiles

NOP, ZEROS, DUMMY = b"\x00\x00\x00\x20", bytes(4), b"\xff\xff\xff\xff"


@pytest.fixture
def reader() -> BitstreamReader:
    return BitstreamReader()


def stored(reader: BitstreamReader, folder: Path, data: bytes) -> Image:
    path = folder / "image.bit"
    path.write_bytes(data)
    return reader.image(path, Expectation())


@pytest.mark.parametrize("padding", [b"", NOP, ZEROS, DUMMY, NOP + ZEROS * 3 + DUMMY])
def test_padding_behind_the_stream_changes_nothing(reader: BitstreamReader, tmp_path: Path, padding: bytes) -> None:
    image = stored(reader, tmp_path, small())
    other = tmp_path / "other.bin"
    other.write_bytes(convert(small(), Container.BIN_SWAPPED) + padding)
    for _ in range(2):  # the second time as it is remembered
        assert reader.configures_as(other, image)
        assert reader.has_words_of(other, image) == (not padding)


def test_another_stream_does_not_configure_alike(reader: BitstreamReader, tmp_path: Path) -> None:
    image = stored(reader, tmp_path, small())
    other = tmp_path / "other.bin"
    other.write_bytes(convert(two_sections(), Container.BIN_SWAPPED))
    assert not reader.configures_as(other, image)
    assert not reader.has_words_of(other, image)


def test_every_section_of_a_stream_counts(reader: BitstreamReader, tmp_path: Path) -> None:
    image = stored(reader, tmp_path, two_sections())
    runs = [FrameRun(HERE, frames(1, b"others")), FrameRun(FrameAddress(1, 2, 3), frames(2, b"more"))]
    other = tmp_path / "other.bit"
    other.write_bytes(assemble("xc7z020", runs, sections=2))  # differs in its first section alone
    assert not reader.configures_as(other, image)


def test_a_file_that_was_replaced_is_not_read_for_what_was_checked(reader: BitstreamReader, tmp_path: Path) -> None:
    image = stored(reader, tmp_path, small())
    assert reader.read(image) == small()
    image.path.write_bytes(two_sections())
    with pytest.raises(Sha256Mismatch, match="was replaced after it had been checked"):
        reader.read(image)
    assert not reader.has_words_of(image.path, image)


# ---- overlays, and the files that they name ---------------------------------------------------------

SCHEMA = """
config:
  name: package
  regions: {r: {}}
  modules: {m: {region: r}}
  overlays: [base]
  modes: {on: {modules: [m]}}
"""
PARTIAL, ENCRYPTED = {"partial-fpga-config": b""}, {"encrypted-fpga-config": b""}
DEVICE = fdt.FdtNode("ip@43c00000", {"compatible": b"xlnx,ip\0"})


def overlay(*names: str, **flags: bytes) -> bytes:
    """It loads what is named, and adds a device."""
    fragments = [
        fdt.overlay("/fpga-full", fdt.FdtNode("", {"firmware-name": name.encode() + b"\0"} | flags, [DEVICE]))
        for name in names
    ]
    tree = fragments[0] if fragments else fdt.overlay("/", fdt.FdtNode("", {}, [DEVICE]))
    for more in fragments[1:]:
        tree.children += [replace(child, name=f"{child.name}-more") for child in more.children]
    return fdt.pack(tree)


class Package:
    """A configuration's folder, and the firmware of the board."""

    def __init__(self, folder: Path) -> None:
        self.own, self.firmware = folder / "package", folder / "root/lib/firmware"
        for one in (self.own, self.firmware / "cm/package"):
            one.mkdir(parents=True)
        self.config = loads(SCHEMA, source=self.own / "schema.yaml")
        self.files = BoardFiles(folder / "root")
        self.image = stored(BitstreamReader(), self.own, small(partial=False, design="ours"))
        self.base, self.module = self.own / "base.dtbo", self.own / "m.dtbo"

    def applied(self, *images: Image) -> fdt.FdtNode:
        return fdt.unpack(self.files.overlay(self.config, Overlay("base"), images))

    def loading(self, image: Image) -> fdt.FdtNode:
        return fdt.unpack(self.files.loading_overlay(self.config, self.config.modules["m"], image))


@pytest.fixture
def package(tmp_path: Path) -> Package:
    return Package(tmp_path)


def damaged(data: bytes) -> bytes:
    return data[:-100] + bytes([data[-100] ^ 1]) + data[-99:]


@pytest.mark.parametrize(
    ("name", "flags", "image", "said"),
    [
        ("../a.bin", {}, {}, "cannot be used (firmware name '../a.bin': a path below /lib/firmware is expected)"),
        ("/a.bin", {}, {}, "cannot be used (firmware name '/a.bin': a path below /lib/firmware is expected)"),
        (
            "x.bit.bin", {}, {}, "cannot be used (there is no such file; looked for OWN/x.bit.bin, "
            "FIRMWARE/cm/package/x.bit.bin, FIRMWARE/x.bit.bin, OWN/x.bin, OWN/x.bit)",
        ),
        ("text.bin", {}, {}, "cannot be used (OWN/text.bin: "),
        ("other.bit", {}, {}, "is another bitstream, OWN/other.bit (partial, theirs); the plan knows OWN/image.bit"),
        ("plain.bit", {}, {}, "is another bitstream, OWN/plain.bit (partial, xc7z020); the plan knows OWN/image.bit"),
        ("broken.bit", {}, {}, "is another bitstream, OWN/broken.bit (whole, ours), which must not be loaded: "),
        (
            "image.bit", {}, None, "is another bitstream, OWN/image.bit (whole, ours); the plan loads nothing of that "
            "kind: list it as a module, or as the bitstream of a full configuration",
        ),
        ("image.bit", PARTIAL, {}, "is a whole image and would be loaded as a partial one: remove partial-fpga-config"),
        (
            "image.bit", {}, {"partial": True},
            "is a partial one and would be loaded as a whole image: add partial-fpga-config",
        ),
        ("image.bit", ENCRYPTED, {}, "is not encrypted: remove encrypted-fpga-config"),
        ("image.bit", {}, {"encrypted": True}, "is encrypted: add encrypted-fpga-config"),
    ],
)  # fmt: skip
def test_what_an_overlay_would_load_is_refused_unless_it_is_what_is_there(
    package: Package, name: str, flags: dict[str, bytes], image: dict[str, Any] | None, said: str
) -> None:
    (package.own / "text.bin").write_text("no bitstream")
    (package.own / "other.bit").write_bytes(small(design="theirs"))
    (package.own / "plain.bit").write_bytes(convert(two_sections(), Container.BIN_SWAPPED))
    (package.own / "broken.bit").write_bytes(damaged(small(partial=False, design="ours")))
    package.base.write_bytes(overlay(name, **flags))
    with pytest.raises(BadOverlay) as refused:
        package.applied(*([] if image is None else [replace(package.image, **image)]))
    said = said.replace("OWN", str(package.own)).replace("FIRMWARE", str(package.firmware))
    assert str(refused.value).startswith(f"{package.base}: its firmware-name {name!r} {said}")


@pytest.mark.parametrize("flags", [{}, PARTIAL, PARTIAL | ENCRYPTED], ids=["whole", "partial", "encrypted"])
def test_an_overlay_loads_nothing_that_is_there_and_a_modules_loads_our_copy(
    package: Package, flags: dict[str, bytes]
) -> None:
    image = replace(package.image, partial="partial-fpga-config" in flags, encrypted="encrypted-fpga-config" in flags)
    for file in (package.base, package.module):
        file.write_bytes(overlay("image.bit", **flags))
    assert package.applied(image) == fdt.overlay("/fpga-full", fdt.FdtNode("", {}, [DEVICE]))
    named = {"firmware-name": f"cm-converted/{image.sha256}.bin".encode() + b"\0"}
    assert package.loading(image) == fdt.overlay("/fpga-full", fdt.FdtNode("", named | flags, [DEVICE]))
    for names in ((), ("image.bit", "image.bit")):
        package.module.write_bytes(overlay(*names, **flags))
        with pytest.raises(BadOverlay, match=rf"m\.dtbo: one firmware-name is expected, there are {len(names)}"):
            package.loading(image)
    package.module.write_bytes(overlay("gone.bit", **flags))
    with pytest.raises(BadOverlay, match=r"m\.dtbo: its firmware-name 'gone\.bit' cannot be used"):
        package.loading(image)


def test_a_name_means_the_packages_own_file_before_those_of_others(package: Package, tmp_path: Path) -> None:
    (tmp_path / "imported").mkdir()
    package.base.symlink_to(tmp_path / "imported/base.dtbo")
    package.base.write_bytes(overlay("a.bin"))
    right = (package.own / "image.bit").read_bytes()
    places = [
        package.own / "a.bin", tmp_path / "imported/a.bin", package.firmware / "cm/package/a.bin",
        package.firmware / "updates/a.bin", package.firmware / "a.bin",
        package.own / "a.bit.bin", package.own / "a.bit",
        tmp_path / "imported/a.bit.bin", tmp_path / "imported/a.bit",
    ]  # fmt: skip
    (package.firmware / "updates").mkdir()
    for place in places:
        place.write_bytes(small(design="theirs"))
    for place in places:
        with pytest.raises(BadOverlay, match=f"is another bitstream, {place} "):
            package.applied(package.image)
        place.write_bytes(right)
        package.applied(package.image)
        place.unlink()


def test_an_overlay_is_read_once_as_long_as_it_is_the_same(package: Package, monkeypatch: pytest.MonkeyPatch) -> None:
    read, reads = Path.read_bytes, list[str]()
    monkeypatch.setattr(Path, "read_bytes", lambda path: (reads.append(path.name), read(path))[1])
    package.base.write_bytes(overlay())
    for _ in range(2):
        assert package.applied() == fdt.overlay("/", fdt.FdtNode("", {}, [DEVICE]))
    assert reads == ["base.dtbo"]
    package.base.write_bytes(overlay("image.bit"))
    package.applied(package.image)
    assert reads == ["base.dtbo"] * 2
    with package.base.open("r+b") as file:
        file.truncate((16 << 20) + 1)
    with pytest.raises(BadOverlay, match=r"base\.dtbo: 16777217 bytes are not an overlay; it has at most 16 MiB"):
        package.applied()
    assert reads == ["base.dtbo"] * 2
    bare = fdt.pack(fdt.FdtNode("", {}, [DEVICE]))
    for blob, said in (
        (b"x", "not a whole device-tree blob ("),
        (bare, "no fragment has an __overlay__ node; compile"),
    ):
        package.base.write_bytes(blob)
        with pytest.raises(BadOverlay) as refused:
            package.applied()
        assert str(refused.value).startswith(f"{package.base}: {said}")


def test_of_images_whose_frames_are_compared_the_last_four_are_kept(package: Package) -> None:
    images = []
    for number in range(5):
        path = package.own / f"{number}.bit"
        path.write_bytes(small(design=f"d{number}"))
        images.append(BitstreamReader().image(path, Expectation()))
    held = [package.files.loaded_frames(image) for image in images[:4]]
    assert package.files.loaded_frames(images[0]) is held[0]  # now the last
    package.files.loaded_frames(images[4])
    assert [package.files.loaded_frames(images[at]) is held[at] for at in (0, 2, 3)] == [True] * 3
    assert package.files.loaded_frames(images[1]) is not held[1]


def test_what_the_kernel_would_find_under_our_name_has_to_be_what_was_checked(package: Package) -> None:
    name = package.files.firmware_name(package.image)
    copy = package.firmware / name
    assert (copy.stat().st_mode & 0o777, copy.parent.stat().st_mode & 0o777) == (0o644, 0o755)
    assert copy.read_bytes() == convert(small(partial=False, design="ours"), Container.BIN_SWAPPED)
    for content, said in (
        (b"no bitstream", ".*; the kernel would load it for"),
        (small(), "not the bitstream that was checked as"),
    ):
        copy.write_bytes(content)
        with pytest.raises(Sha256Mismatch, match=f"{copy}: {said} {package.image.path}"):
            package.files.check_firmware(name, package.image)


@pytest.mark.parametrize(
    ("image", "allowed", "why", "key"),
    [
        (small()[:-40], "", "bitstream_truncated", "module's key bitstream"),
        (small(), "    footprint: [{row: 0, columns: [60, 61]}]\n", "footprint_outside", "region's key footprint"),
    ],
)
def test_a_refused_bitstream_is_named_with_its_module_its_region_and_the_key_that_mends_it(
    tmp_path: Path, image: bytes, allowed: str, why: str, key: str
) -> None:
    schema = "config:\n  name: c\n  type: partial\n  device: xc7z020\n  regions:\n   r:\n    timeout: 9\n"
    schema += f"{allowed}  modules: {{m: {{region: r}}}}\n  modes: {{a: {{modules: [m]}}}}\n"
    config = loads(schema, source=tmp_path / "c.yaml")
    (tmp_path / "m.bit").write_bytes(image)
    with pytest.raises(BitstreamError) as refused:
        BoardFiles(tmp_path / "root").image(config, config.modules["m"])
    told = str(refused.value)
    assert (refused.value.code, told.count(str(tmp_path))) == (why, 1)
    assert told.startswith(f"{tmp_path / 'm.bit'}, of module m of region r in c: ")
    assert key in told
