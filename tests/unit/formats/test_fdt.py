# SPDX-License-Identifier: Apache-2.0
"""Flattened device trees: those of dtc are read, and those that are written are read by libfdt."""

from __future__ import annotations

import contextlib
import struct
import subprocess
from pathlib import Path

import pytest
from build_support import needs
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cm.formats import fdt
from cm.formats.fdt import FdtError, FdtNode

names = st.sampled_from(["compatible", "reg", "#address-cells", "status", "a,b-c"])
properties = st.dictionaries(names, st.binary(max_size=9), max_size=3)
QUICK = settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])  # of a busy machine


def siblings(nodes: st.SearchStrategy[FdtNode]) -> st.SearchStrategy[list[FdtNode]]:
    return st.lists(nodes, unique_by=lambda node: node.name)


leaves = st.builds(FdtNode, names, properties)
trees = st.builds(FdtNode, st.just(""), properties, siblings(st.builds(FdtNode, names, properties, siblings(leaves))))
reservations = st.lists(st.tuples(st.integers(0, 2**64 - 1), st.integers(1, 2**64 - 1)), max_size=3).map(tuple)

SOURCE = """/dts-v1/;
/plugin/;
/memreserve/ 0x1000 0x20;
&fpga_full {
    firmware-name = "design.bit.bin";
    #address-cells = <1>;
    timer@40000000 {
        compatible = "xlnx,axi-timer-2.0", "generic-uio";
        reg = <0x40000000 0x1000>;
        clocks = <&clkc 15>;
    };
};
"""
TIMER = "/fragment@0/__overlay__/timer@40000000"


@pytest.fixture
def compiled(tmp_path: Path) -> bytes:
    (tmp_path / "a.dtso").write_text(SOURCE)
    command = ["dtc", "-q", "-@", "-I", "dts", "-O", "dtb", "-o", "a.dtbo", "a.dtso"]
    subprocess.run(command, check=True, cwd=tmp_path)
    return (tmp_path / "a.dtbo").read_bytes()


@given(trees)
@QUICK
def test_a_tree_is_the_same_after_packing_and_unpacking(tree: FdtNode) -> None:
    assert fdt.unpack(fdt.pack(tree)) == tree


@given(trees, reservations, st.integers(0, 2**32 - 1))
@QUICK
def test_a_blob_that_is_written_as_it_was_read_is_the_same(tree, reserved, cpu) -> None:
    blob = fdt.write(fdt.Fdt(tree, reserved, cpu))
    assert fdt.write(fdt.read(blob)) == blob


@given(trees, st.data())
@QUICK
def test_a_damaged_blob_is_a_tree_or_an_error_and_nothing_else(tree: FdtNode, data: st.DataObject) -> None:
    packed = bytearray(fdt.pack(tree))
    packed[data.draw(st.integers(0, len(packed) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(FdtError):
        fdt.unpack(bytes(packed[: data.draw(st.integers(0, len(packed)))]))


@given(trees, st.data())
@QUICK
def test_a_blob_that_is_cut_off_is_refused(tree: FdtNode, data: st.DataObject) -> None:
    packed = fdt.pack(tree)
    with pytest.raises(FdtError):
        fdt.unpack(packed[: data.draw(st.integers(0, len(packed) - 1))])


def test_nodes_have_their_paths() -> None:
    tree = FdtNode("", {}, [FdtNode("a", {}, [FdtNode("b")]), FdtNode("c")])
    assert [path for path, _ in fdt.unpack(fdt.pack(tree)).walk()] == ["/", "/a", "/a/b", "/c"]


def test_the_first_string_of_a_list_is_its_text() -> None:
    node = FdtNode("", {"compatible": b"a,b\0generic-uio\0", "empty": b""})
    assert (node.text("compatible"), node.text("empty"), node.text("none")) == ("a,b", "", None)


@pytest.mark.design
@needs("dtc")
def test_what_dtc_compiled_is_read(compiled: bytes) -> None:
    found = dict(fdt.unpack(compiled).walk())
    assert found[TIMER].properties["reg"] == struct.pack(">II", 0x40000000, 0x1000)
    assert found[TIMER].text("compatible") == "xlnx,axi-timer-2.0"
    assert found["/__fixups__"].text("fpga_full") == "/fragment@0:target:0"
    assert fdt.read(compiled).reserved == ((0x1000, 0x20),)


@pytest.mark.design
@needs("dtc")
@needs("fdtget")
def test_a_longer_firmware_name_is_all_that_differs_to_libfdt(compiled: bytes, tmp_path: Path) -> None:
    wanted = b"cm-converted/0123456789abcdef/design.bin\0"
    changed = fdt.read(compiled)
    dict(changed.root.walk())["/fragment@0/__overlay__"].properties["firmware-name"] = wanted
    (tmp_path / "b.dtbo").write_bytes(fdt.write(changed))
    get = ["fdtget", "-t", "s", "b.dtbo", "/fragment@0/__overlay__", "firmware-name"]
    assert subprocess.run(get, check=True, cwd=tmp_path, capture_output=True).stdout.strip() + b"\0" == wanted
    texts = []
    for path in ("a.dtbo", "b.dtbo"):
        command = ["dtc", "-q", "-I", "dtb", "-O", "dts", path]
        texts.append(subprocess.run(command, check=True, cwd=tmp_path, capture_output=True, text=True).stdout)
    assert texts[1].replace(wanted[:-1].decode(), "design.bit.bin") == texts[0]


@pytest.mark.design
@needs("dtc")
def test_an_older_blob_of_version_16_is_read(compiled: bytes, tmp_path: Path) -> None:
    (tmp_path / "new.dtb").write_bytes(compiled)
    command = ["dtc", "-q", "-I", "dtb", "-O", "dtb", "-V", "16", "-o", "old.dtb", "new.dtb"]
    subprocess.run(command, check=True, cwd=tmp_path)
    assert fdt.read((tmp_path / "old.dtb").read_bytes()) == fdt.read(compiled)


def structure(*tokens: bytes | int) -> bytes:
    """A blob of that structure block; its strings are ``a`` and ``b``."""
    body = b"".join(token if isinstance(token, bytes) else struct.pack(">I", token) for token in tokens)
    start = 40 + 16
    words = (fdt.MAGIC, start + len(body) + 4, start, start + len(body), 40, 17, 16, 0, 4, len(body))
    return struct.pack(">10I", *words) + bytes(16) + body + b"a\0b\0"


def prop(value: bytes, offset: int) -> bytes:
    return struct.pack(">III", 3, len(value), offset) + value + bytes(-len(value) % 4)


ROOT = struct.pack(">II", 1, 0)
END = struct.pack(">II", 2, 9)


def node(name: bytes) -> bytes:
    return struct.pack(">I", 1) + name + bytes(4 - len(name) % 4)


def test_nop_tokens_are_skipped() -> None:
    assert fdt.unpack(structure(4, ROOT, 4, prop(b"x", 0), 4, END)).properties == {"a": b"x"}


def test_nodes_as_deep_as_the_kernel_takes_are_read_and_deeper_ones_refused() -> None:
    def deep(count: int) -> bytes:
        return structure(ROOT, node(b"n") * (count - 1), struct.pack(">I", 2) * count, 9)

    assert len(list(fdt.unpack(deep(fdt.MAX_DEPTH)).walk())) == fdt.MAX_DEPTH
    with pytest.raises(FdtError, match="deep"):
        fdt.unpack(deep(fdt.MAX_DEPTH + 1))


@pytest.mark.parametrize(
    ("blob", "reason"),
    [
        (structure(ROOT, prop(b"x", 0), prop(b"y", 0), END), "property 'a' twice"),
        (structure(ROOT, node(b"n"), 2, node(b"n"), 2, END), "node 'n' twice"),
        (structure(ROOT, node(b"n/m"), 2, END), "slash"),
        (structure(ROOT, node(b"\xff"), 2, END), "not ASCII"),
        (structure(ROOT, prop(b"", 9), END), "outside its block"),
        (structure(ROOT, struct.pack(">III", 3, 99, 0), END), "leaves the structure"),
        (structure(ROOT, 7, END), "token 0x7"),
        (structure(prop(b"", 0), END), "does not begin with a node"),
        (structure(ROOT, 2, ROOT), "follows the root"),
        (structure(ROOT), "ends too early"),
        (bytes(40), "begins with 00000000"),
        (b"", "0 bytes"),
    ],
)
def test_the_error_for_a_blob_says_what_is_wrong(blob: bytes, reason: str) -> None:
    with pytest.raises(FdtError, match=reason):
        fdt.unpack(blob)


def test_reservations_without_an_end_are_refused() -> None:
    blob = bytearray(fdt.pack(FdtNode()))
    blob[16:20] = struct.pack(">I", len(blob) - 8)
    with pytest.raises(FdtError, match="reservation block has no end"):
        fdt.unpack(bytes(blob))


@pytest.mark.parametrize(("version", "compatible"), [(15, 15), (18, 18)])
def test_another_version_is_refused(version: int, compatible: int) -> None:
    blob = bytearray(fdt.pack(FdtNode()))
    blob[20:28] = struct.pack(">II", version, compatible)
    with pytest.raises(FdtError, match=f"version {version}"):
        fdt.unpack(bytes(blob))
