# SPDX-License-Identifier: Apache-2.0
"""The accelerators that the paper's authors published (accl-kaust/zypr), untouched, in `cm serve --sim=rtl`.

ZYPR names a checkout; nothing of it is in this repository. What they should give is worked out in
`examples/zypr/references.py`, from the operations' definitions.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
from conftest import HERE, needs, served

import cm

sys.path += [str(HERE.parent), str(HERE.parents[1] / "examples/zypr")]
import authors
import references

from cm.cli.main import main
from cm.design.zypr import zypr_text
from cm.simulation.rtl.errors import RtlError
from cm.simulation.rtl.main import prepare
from cm.simulation.software.hardware.camera import shipped_photos

ZYPR = os.environ.get("ZYPR")
pytestmark = [
    needs("verilator"), needs("g++"), pytest.mark.timeout(900),
    pytest.mark.skipif(not ZYPR, reason="ZYPR does not name a checkout of github.com/accl-kaust/zypr"),
]  # fmt: skip
PHOTO = next(iter(shipped_photos().values()))
FAST = ("--sim-icap-rate", "0")


@pytest.fixture(scope="module")
def schemas(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    return authors.prepare(Path(str(ZYPR)).absolute(), tmp_path_factory.mktemp("authors"))


@pytest.fixture(scope="module")
def vision(schemas: Mapping[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Iterator[cm.Board]:
    with served(tmp_path_factory.mktemp("run"), schemas["vision"], schemas["vision"].stem, *FAST) as connected:
        yield connected


@pytest.fixture(scope="module")
def words(schemas: Mapping[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Iterator[cm.Board]:
    with served(tmp_path_factory.mktemp("run"), schemas["words"], schemas["words"].stem, *FAST) as connected:
        yield connected


@pytest.mark.parametrize("few", [False, True], ids=["many edges", "few edges"])
@pytest.mark.parametrize("one", authors.FILTERS, ids=lambda one: one.module)
def test_a_filter_gives_the_picture_of_its_definition(vision: cm.Board, one: authors.Filter, few: bool) -> None:
    picture = authors.picture_for(one, PHOTO, one.shapes[few][0])
    assert np.array_equal(authors.act(vision, one, few, picture), authors.expected(one, few, picture))


def test_chroma_as_it_was_published_is_black(vision: cm.Board) -> None:
    """Its second stage is given zeros (chroma.v, lines 330 and 359)."""
    one = next(one for one in authors.FILTERS if one.module == "chroma_mended")
    picture = authors.picture_for(one, PHOTO, one.shapes[0][0])
    assert references.chroma(picture).any()
    published = authors.Filter("chroma", one.into, one.out, one.settings, one.shapes)
    assert not authors.act(vision, published, False, picture).any()


def test_one_region_streams_on_while_the_other_changes_its_filter(vision: cm.Board) -> None:
    resize = next(one for one in authors.FILTERS if one.module == "resize")
    authors.act(vision, resize, False, PHOTO)
    ended, pictures = threading.Event(), []
    vision.registers["ap_ctrl"] = authors.START | authors.AUTO_RESTART
    with vision.stream(resize.out, timeout=120, depth=4) as back, vision.writer(resize.into, timeout=120) as out:

        def stream() -> None:
            while not ended.is_set():
                out.write(PHOTO)
                pictures.append(np.array(back.read()))

        streaming = threading.Thread(target=stream)
        streaming.start()
        try:
            for module in ("sobel_b", "sobel_a", "sobel_b"):
                before = len(pictures)
                vision.set_mode(module)
                while len(pictures) < before + 2:
                    assert streaming.is_alive()
        finally:
            ended.set()
            streaming.join(120)
    assert len(pictures) >= 6
    assert all(np.array_equal(one, references.resize(PHOTO, authors.HALF)) for one in pictures)


@pytest.mark.parametrize("module", ["passthrough_a", "passthrough_b"])
def test_the_fifo_gives_back_what_went_in(words: cm.Board, module: str) -> None:
    words.set_mode(module)
    data = np.random.default_rng(1).integers(0, 1 << 32, 256, np.uint32)
    with words.stream("from_left", timeout=60) as back, words.writer("to_left") as out:
        out.write(data)
        assert np.array_equal(back.read(), data)


@pytest.mark.parametrize("module", ["vadd_a", "vadd_b"])
def test_ten_is_added_to_each_of_ten_words(words: cm.Board, module: str) -> None:
    words.set_mode(module)
    data = np.random.default_rng(2).integers(0, 1 << 32, 10, np.uint32)
    with words.stream("from_right", timeout=60) as back, words.writer("to_right") as out:
        words.registers["ap_ctrl"] = authors.START
        out.write(data)
        assert np.array_equal(back.read(), data + np.uint32(10))


@pytest.mark.parametrize(("module", "reset", "added"), [("mem_a", (1, 2, 3, 4), -4), ("mem_b", (8, 7, 6, 5), 4)])
def test_the_memories_add_to_each_byte_that_is_written(
    words: cm.Board, module: str, reset: tuple[int, ...], added: int
) -> None:
    words.set_mode(module)
    names = ("first", "second", "third", "fourth")
    assert tuple(words.registers.read(*names).values()) == reset
    words.registers["first"] = 0x10203040
    assert words.registers["first"] == sum(((0x10203040 >> 8 * byte) + added & 0xFF) << 8 * byte for byte in range(4))


def gaussian(schema: Path, models: bool) -> Path:
    """A build schema for it; with simulation models of the cores, if they are given."""
    folder = (schema.parent / "zypr/gaussian").resolve()
    sources = [
        path for path in sorted(folder.glob("*.v")) if "sim_netlist" not in path.name and "stub" not in path.name
    ]
    files = f"sources: [{', '.join(map(str, sources))}]"
    if models:  # in place of the black boxes of ignore.v
        own = [path for path in sources if path.name != "ignore.v"]
        files += f", sim_sources: [{', '.join(map(str, [*own, HERE / 'floats/cores.sv']))}]"
    registers = folder / "gaussian_AXILiteS_s_axi.v"
    schema.write_text(
        "project: {name: gaussian, part: xczu3eg-sbva484-1-i}\nclocks: {pl0: {rate: 100_000_000}}\n"
        "regions: {prr0: {pblock: auto, resources: {lut: 9000, dsp: 60}, clock: pl0, interfaces: {"
        "stream_in: {stream: to_blur, shape: [24, 48]}, stream_out: {stream: from_blur, shape: [24, 48]}}}}\n"
        f"modules: {{top: {{{files}, register_map: {registers}, resources: {{lut: 8000}}}}}}\n"
        "modes: {top: {modules: [top], run: once, registers: {rows_in: 24, cols_in: 48, sigma: 0x3f800000}}}\n"
    )
    return schema


def test_gaussian_runs_with_models_of_the_cores_that_it_lacks(
    schemas: Mapping[str, Path], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Within one of a kernel of 3 × 3 with sigma 1: its weights are of 8 bits. Borders are left out."""
    schema = gaussian(schemas["vision"].with_name("gaussian.yaml"), models=True)
    with served(tmp_path_factory.mktemp("run"), schema, schema.stem, *FAST) as board:
        picture = np.ascontiguousarray(PHOTO[:240:10, :480:10])
        with board.stream("from_blur", timeout=120) as back, board.writer("to_blur", timeout=120) as out:
            out.write(picture)
            result = np.asarray(back.read())
    weights = np.exp(-np.array([1, 0, 1]) / 2)
    kernel = np.outer(weights, weights) / weights.sum() ** 2
    windows = np.lib.stride_tricks.sliding_window_view(picture.astype(float), (3, 3))
    wanted = (windows * kernel).sum(axis=(2, 3))
    assert np.abs(result[1:-1, 1:-1] - wanted).max() <= 2


def test_gaussian_is_refused_with_the_cores_that_it_lacks(schemas: Mapping[str, Path]) -> None:
    schema = gaussian(schemas["vision"].with_name("refused.yaml"), models=False)
    with pytest.raises(RtlError, match=r"module top: nothing is in .*gaussian_ap_fexp_6_full_dsp_32.*sim_sources"):
        prepare(schema)


@pytest.mark.parametrize("name", ["sobel", "vadd", "vision", "vision2", "test"])
def test_a_project_file_goes_from_init_to_generate_without_a_line_by_hand(name: str, tmp_path: Path) -> None:
    found = next(Path(str(ZYPR)).rglob(f"tests/demo/{name}.json"))
    schema = tmp_path / f"{name}.yaml"
    assert main(["build", "init", "--from", "zypr", str(found), "--output", str(schema)]) == 0
    assert main(["build", "check", str(schema)]) == 0
    assert main(["build", "generate", str(schema), "--out", str(tmp_path / "build")]) == 0


def test_their_sobel_project_runs_as_init_writes_it(tmp_path: Path) -> None:
    """Two regions, each with either filter, and a VDMA each."""
    schema = tmp_path / "example.yaml"
    schema.write_text(zypr_text(next(Path(str(ZYPR)).rglob("tests/demo/sobel.json")), tmp_path))
    with served(tmp_path / "run", schema, schema.stem, *FAST) as board:
        for mode, region in (("sobel_a_region_a", "region_a"), ("sobel_b_region_b", "region_b")):
            board.set_mode(mode)
            board.registers.write({"rows": 480, "cols": 640})
            with board.stream(f"from_{region}", timeout=120) as back, board.writer(f"to_{region}", timeout=120) as out:
                board.registers["ap_ctrl"] = authors.START
                out.write(PHOTO.astype(np.uint64))
                assert np.array_equal(back.read(), references.sobel(PHOTO))
