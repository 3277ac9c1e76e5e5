# SPDX-License-Identifier: Apache-2.0
"""Features and frames, held against Project X-Ray's database and its own programs.

They come from Debian's sid, fetched once into the user's cache; without them, the tests are skipped.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Mapping
from pathlib import Path

import pytest
from xray_oracle import DATABASE, fetched_or_skipped, frames_read, part, read_bits, run

from cm.design.debian_packages import PackageTree
from cm.formats.bitstream import FrameRun, assemble
from cm.formats.bitstream.geometry import decode_far
from cm.formats.bitstream.idcodes import Family, device_by_name
from cm.formats.bitstream.mask import mask_for
from cm.formats.xray import (
    Database,
    DatabaseMissing,
    Feature,
    Tile,
    Wires,
    XrayError,
    decode,
    describe_bits,
    encode,
    fasm,
    find_database,
    from_bytes,
    read_features,
    set_bits,
    to_bytes,
    volatile_bits,
    with_ecc,
)
from cm.formats.xray.fabric import fabric, named

pytestmark = pytest.mark.open


@pytest.fixture(scope="module")
def tree() -> PackageTree:
    return fetched_or_skipped()


@pytest.fixture(scope="module", params=["xc7z010", "xc7z020"])
def database(request: pytest.FixtureRequest, tree: PackageTree) -> Database:
    return Database.open(f"{request.param}clg400-1", tree.path(DATABASE))


def some_features(database: Database, seed: int, tiles: int) -> set[Feature]:
    """Features in some tiles: a source for each of 40 wires, and half of the bits of the look-up tables."""
    draw = random.Random(seed)
    names = sorted(tile.name for tile in database.tiles.values() if tile.kind[:4] in ("INT_", "CLBL") and tile.segments)
    found = set()
    for name in draw.sample(names, tiles):
        kind = database.tiles[name].kind
        sources: dict[str, list[str]] = {}
        for feature in sorted(database.segbits(kind).features):
            key = feature if "INIT[" in feature else feature.partition(".")[0]
            sources.setdefault(key, []).append(feature)
        if kind.startswith("CLB"):
            found |= {Feature(name, key) for key in sources if "INIT[" in key and draw.random() < 0.5}
        else:
            found |= {Feature(name, draw.choice(sources[key])) for key in draw.sample(sorted(sources), 40)}
    return found


def runs_of(frames: dict[int, int]) -> list[FrameRun]:
    """Each frame with its pad; in order, because bitread takes the pad for the next frame."""
    data = {far: to_bytes(frame) + bytes(404) for far, frame in sorted(frames.items())}
    return [FrameRun(decode_far(far, Family.SERIES7), frame) for far, frame in data.items()]


def test_features_come_back_from_their_frames(database: Database) -> None:
    given = some_features(database, 1, 300)
    encoded = encode(database, given)
    assert (encoded.unresolved, encoded.clashes) == ((), ())
    decoded = decode(database, encoded.frames)
    assert decoded.features == given
    assert not decoded.unexplained


def test_what_a_bit_belongs_to(database: Database) -> None:
    """Of a table it is the feature itself, of a switch the wire that it drives, which all its features begin with."""
    wanted = {}
    for kind, name, what in (("CLBLL_L", "SLICEL_X0.BLUT.INIT[3]", ""), ("INT_L", "BYP_ALT0.GFAN0", "BYP_ALT0")):
        tile = next(tile for tile in database.tiles.values() if tile.kind == kind and tile.segments)
        (segment,) = tile.segments
        bit = database.segbits(segment.kind, segment.block).features[name][0]
        wanted[segment.base + bit.frame, bit.position + segment.shift] = f"{tile.name} {what or name}"
    assert describe_bits(database, [*wanted, (0x7FFFFF, 0)]) == wanted


def test_bitread_finds_the_bits_of_the_features(database: Database, tree: PackageTree, tmp_path: Path) -> None:
    frames = encode(database, some_features(database, 2, 60)).frames
    plain = encode(database, some_features(database, 2, 60), ecc=False).frames
    expected = {(far, *divmod(position, 32)) for far, frame in plain.items() for position in set_bits(frame)}
    assert read_bits(tree, database.fabric, assemble(database.fabric, runs_of(frames)), tmp_path) == expected


def test_checksums_are_those_of_xc7frames2bit(tree: PackageTree, tmp_path: Path) -> None:
    draw = random.Random(3)
    given = {0x401200 + minor: from_bytes(draw.randbytes(404)) for minor in range(36)}
    lines = (
        f"0x{far:08x} " + ",".join(f"0x{word:08x}" for word in struct.unpack(">101I", to_bytes(frame)))
        for far, frame in given.items()
    )
    (tmp_path / "in.frm").write_text("\n".join(lines) + "\n")
    files = ["--frm_file", str(tmp_path / "in.frm"), "--output_file", str(tmp_path / "out.bit")]
    options = ["--part_name", "xc7z010clg400-1", "--part_file", str(part(tree, "xc7z010"))]
    run(tree, "xc7frames2bit", *options, *files)
    written = frames_read(tmp_path / "out.bit", "xc7z010")
    assert {far: from_bytes(written[far]) for far in given} == {far: with_ecc(frame) for far, frame in given.items()}


def test_bits_with_two_values_and_features_that_are_unknown_are_reported(tree: PackageTree) -> None:
    database = Database.open("xc7z010", tree.path(DATABASE))
    one, other = (Feature("INT_L_X16Y87", f"BYP_ALT0.{source}") for source in ("FAN_BOUNCE2", "FAN_BOUNCE7"))
    unknown = {Feature("INT_L_X16Y87", "BYP_ALT0.NOWHERE"), Feature("INT_L_X999Y87", "BYP_ALT0.FAN_BOUNCE2")}
    encoded = encode(database, {one, other, *unknown})
    assert set(encoded.unresolved) == unknown
    assert {(clash.one, clash.zero) for clash in encoded.clashes} == {(other, one), (one, other)}
    assert "sets bit" in str(encoded.clashes[0])


def test_pips_without_bits_are_known_and_set_nothing(tree: PackageTree) -> None:
    database = Database.open("xc7z010", tree.path(DATABASE))
    encoded = encode(database, {Feature("INT_L_X16Y87", "BYP_ALT0.VCC_WIRE")})
    assert (encoded.frames, encoded.unresolved) == ({}, ())


def test_a_tile_described_as_another_kind_has_its_bits_where_bitread_sees_them(
    tree: PackageTree, tmp_path: Path
) -> None:
    """RIOB33_SING tiles at the ends of an I/O column have one half of the bits of a RIOB33."""
    database = Database.open("xc7z010", tree.path(DATABASE))
    tile = database.tiles["RIOB33_SING_X31Y0"]
    given = {Feature(tile.name, "IOB_Y0.PULLTYPE.KEEPER")}
    other_half = Feature(tile.name, "IOB_Y1.PULLTYPE.KEEPER")
    encoded = encode(database, {*given, other_half})
    assert encoded.unresolved == (other_half,)
    frames = encoded.frames
    assert given <= decode(database, frames).features
    read = read_bits(tree, "xc7z010", assemble("xc7z010", runs_of(frames)), tmp_path)
    assert {word for _, word, _ in read} <= {0, 1}


def places_of(database: Database, tile: str, names: str) -> set[tuple[int, int]]:
    """Where the features of a tile that begin so have their bits."""
    (segment,) = (one for one in database.tiles[tile].segments if one.block == "CLB_IO_CLK")
    found = database.segbits(segment.kind).features.items()
    bits = (bit for name, bits in found if name.startswith(names) for bit in bits)
    return {(segment.base + bit.frame, bit.position + segment.shift) for bit in bits}


def masked(masks: Mapping[int, int | None]) -> set[tuple[int, int]]:
    return {(address, at) for address, mask in masks.items() for at in set_bits(mask or 0)}


def column(tile: Tile) -> dict[int, int]:
    (segment,) = (one for one in tile.segments if one.block == "CLB_IO_CLK")
    return dict.fromkeys(range(segment.base, segment.base + segment.frames), 0)


@pytest.mark.parametrize("use", ["RAM", "SRL"])
def test_contents_of_tables_are_volatile_where_the_frames_say_that_they_are_memory(tree: PackageTree, use: str) -> None:
    database = Database.open("xc7z010", tree.path(DATABASE))
    name = next(name for name, tile in database.tiles.items() if tile.kind == "CLBLM_R")
    frames = column(database.tiles[name])
    before = masked(volatile_bits(database, frames))
    assert not before & places_of(database, name, "SLICEM_X0.BLUT")
    table = {Feature(name, f"SLICEM_X0.BLUT.{use}"), Feature(name, "SLICEM_X0.ALUT.INIT[0]")}
    after = masked(volatile_bits(database, frames | encode(database, table).frames))
    assert after - before == places_of(database, name, "SLICEM_X0.BLUT.INIT[")
    assert len(after - before) == 64


def test_what_a_register_begins_with_is_volatile_as_a_capture_overwrites_it(tree: PackageTree) -> None:
    database = Database.open("xc7z010", tree.path(DATABASE))
    name = next(name for name, tile in database.tiles.items() if tile.kind == "CLBLL_L")
    found = masked(volatile_bits(database, column(database.tiles[name])))
    begins = [f"SLICEL_X{side}.{letter}{ff}.ZINI" for side in "01" for letter in "ABCD" for ff in ("FF", "5FF")]
    assert {bit for begin in begins for bit in places_of(database, name, begin)} < found
    assert len(found) == 16 * 50  # sixteen registers in each of fifty tiles, and nothing else


def test_contents_of_block_ram_are_volatile_and_its_settings_are_not(tree: PackageTree) -> None:
    database = Database.open("xc7z010", tree.path(DATABASE))
    settings, contents = 0xB00, 0x800100
    masks = volatile_bits(database, {settings: 0, contents: 0})
    assert masks == {settings: 0, contents: (1 << 3232) - 1}


def test_frames_that_the_database_does_not_know_cannot_be_judged(tree: PackageTree) -> None:
    """The XADC has bits in this column and none in the database; there is no column 0x7F."""
    database = Database.open("xc7z010", tree.path(DATABASE))
    assert volatile_bits(database, {0x1100: 0, 0x3F80: 0, 0x900: 0}) == {0x1100: None, 0x3F80: None, 0x900: 0}


def test_the_database_knows_kinds_of_columns_and_the_tiles_of_each_row(tree: PackageTree) -> None:
    database = Database.open("xc7z010", tree.path(DATABASE))
    starts = (0xC80, 0x1380, 0x1400, 0x1480, 0x1500, 0x1B80)
    columns = {column.address: column for column in named(fabric(dict.fromkeys(starts, 0)), database)}
    kinds = ["DSP", "clock spine", "CLB", "CLB with memory", "block RAM", "I/O"]
    assert [columns[start].kind for start in starts] == kinds
    names = columns[0x1480].names
    assert [names[row] for row in (0, 49)] == ["CLBLM_R_X17Y50, INT_R_X17Y50", "CLBLM_R_X17Y99, INT_R_X17Y99"]
    assert [columns[0x1500].names[row].partition(",")[0] for row in (0, 4, 5)] == ["BRAM_L_X18Y50"] * 2 + [
        "BRAM_L_X18Y55"
    ]


def test_wires_of_one_node_are_joined_over_tiles(tree: PackageTree) -> None:
    wires = Wires(Database.open("xc7z010", tree.path(DATABASE)))
    node = wires.node("INT_L_X16Y87", "NW6BEG1")
    assert {("INT_L_X16Y87", "NW6BEG1"), ("INT_L_X14Y91", "NW6END1"), ("INT_R_X15Y91", "NW6E1")} <= node
    assert wires.node("INT_L_X14Y91", "NW6END1") == node
    pip = wires.kind("INT_L").pips["NW6BEG1.LOGIC_OUTS_L1"]
    assert (pip.source, pip.destination, pip.both_ways) == ("LOGIC_OUTS_L1", "NW6BEG1", False)
    assert ("CLBLL_L_X16Y87", "CLBLL_LOGIC_OUTS1") in wires.node("INT_L_X16Y87", "LOGIC_OUTS_L1")


def test_lines_of_fasm_are_read_with_values_and_comments() -> None:
    lines = [
        "# a comment",
        "",
        "T.S.INIT[5:2] = 4'b1010 # more",
        'T.S.ON {.a = "b"}',
        "T.S.OFF = 0",
        "T.S.M[07] = 1'h1",
    ]
    expected = {Feature("T", "S.INIT[3]"), Feature("T", "S.INIT[5]"), Feature("T", "S.ON"), Feature("T", "S.M[7]")}
    assert read_features(lines) == expected
    assert read_features(fasm(expected).splitlines()) == expected


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("T.S.INIT[1:0] = 3'b111", "7 does not fit 2 bits"),
        ("no feature", "is not a line of FASM"),
        ("T.A = 2'b12", "is not a number of base 2"),
        ("T.A[0:3] = 4'b0", "does not fit"),
    ],
)
def test_a_line_that_is_not_fasm_is_reported_with_its_line_number(line: str, told: str) -> None:
    with pytest.raises(XrayError, match=r"x\.fasm, line 2: .*" + told):
        read_features(["T.A", line], "x.fasm")


def test_a_database_or_a_part_that_is_not_there_is_reported(
    tree: PackageTree, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CM_XRAY_DATABASE", str(tmp_path / "none"))
    with pytest.raises(DatabaseMissing, match="cm build tools --fetch"):
        find_database()
    monkeypatch.setenv("CM_XRAY_DATABASE", str(tree.path(DATABASE)))
    with pytest.raises(DatabaseMissing, match=r"no part 'xczu3eg'; it has .*xc7z010clg400-1"):
        Database.open("xczu3eg")
    assert Database.open("xc7a35tcsg324-1").fabric == "xc7a50t"
    assert Database.open("xc7z020").idcode & 0xFFFFFFF == 0x3727093
    frames, device = {0x1400: 1, 0x800100: 1}, device_by_name("xc7z020")
    assert device is not None
    mask = mask_for(tmp_path / "no.bit", device)
    assert (mask.source, mask.why) == ("xray", "Project X-Ray's database says what is not compared")
    assert mask.of(frames) == volatile_bits(Database.open("xc7z020"), frames)
