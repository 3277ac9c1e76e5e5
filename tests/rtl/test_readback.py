# SPDX-License-Identifier: Apache-2.0
"""The configuration port's way back (cm_icap_read.v) at the models of ICAPE2 and ICAPE3, and at the vendor's.

CM_UNISIM names a folder with the vendor's, as for test_config_port.py.
"""

from __future__ import annotations

import os
import random
import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest
from build_support import copy_examples, generated
from conftest import HERE, needs
from simulation import simulate
from test_lint import lint

from cm.design.generate.generation import Design

READ = HERE.parent.parent / "cm/design/rtl/readback/cm_icap_read.v"
MODELS = sorted((HERE / "models").glob("*.v"))

pytestmark = [needs("iverilog"), pytest.mark.timeout(600)]


@pytest.mark.parametrize(("port", "depth"), [("ICAPE2", 10), ("ICAPE2", 4), ("ICAPE3", 10)])
def test_what_was_loaded_is_read_back(port: str, depth: int, tmp_path: Path) -> None:
    parameters = {"ULTRASCALE": int(port == "ICAPE3"), "DEPTH_BITS": depth}
    ran = simulate(
        "cm_icap_read", [READ, *MODELS], "cocotb_readback", tmp_path, parameters=parameters,
        CM_PORT=port, CM_DEPTH_BITS=str(depth),
    )  # fmt: skip
    assert len(ran) == (9 if port == "ICAPE3" else 8)


@needs("verilator")
@pytest.mark.parametrize("ultrascale", [0, 1])
def test_the_feeder_is_clean(ultrascale: int) -> None:
    lint("--top-module", "cm_icap_read", f"-GULTRASCALE={ultrascale}", "-y", HERE / "models", READ)


@pytest.fixture(scope="module")
def camera(tmp_path_factory: pytest.TempPathFactory) -> tuple[Design, Path]:
    """The camera example with a port that can be read, 16 pixels a line."""
    folder = copy_examples(tmp_path_factory.mktemp("camera"))
    schema = folder / "camera/build.yaml"
    text = schema.read_text().replace("    top: camera_edge\n", "    top: camera_edge\n    parameters: {LINE: 16}\n")
    schema.write_text(f"{text}static: {{readback: true}}\n")
    return generated(folder, "camera")


def test_a_static_part_reads_its_port_while_pictures_pass(camera: tuple[Design, Path], tmp_path: Path) -> None:
    design, out = camera
    one = design.system.implementation("edge", "prr0")
    sources = [out / "hdl/cm_static.v", *sorted((out / "hdl/lib").glob("*.v")), *MODELS, *one.module.sources]
    sources.append(out / "wrappers/edge/cm_region_prr0.v")
    assert simulate("cm_static", sources, "cocotb_readback_system", tmp_path, only="the_port", CM_MODULE="edge")


@needs("verilator")
def test_a_static_part_with_it_is_clean(camera: tuple[Design, Path]) -> None:
    hdl = camera[1] / "hdl"
    lint("--top-module", "cm_static", "-y", hdl, "-y", hdl / "lib", "-y", HERE / "models", hdl / "cm_static.v")


SYNC, NOP = 0xAA995566, 0x20000000
DESYNC = [0x30008001, 13, NOP, NOP]


def lines(packets: Sequence[tuple[Sequence[int], bool]]) -> list[str]:
    """What the bench reads, of (words, whether an answer follows)."""
    found = []
    for words, asks in packets:
        found += [f"{word:09x}" for word in words[:-1]]
        found.append(f"{(2 * asks + 1) << 32 | words[-1]:09x}")
    return found


def on_icarus(folder: Path, sources: Sequence[Path], **parameters: int) -> list[str]:
    given = [f"-Ptb_icap_read.{name}={value}" for name, value in parameters.items()]
    tops = ["-s", "tb_icap_read", *(["-s", "glbl"] if any(path.name == "glbl.v" for path in sources) else [])]
    command = ["iverilog", "-g2012", "-o", "bench.vvp", *tops, *given, *map(str, sources)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return output(["vvp", "bench.vvp"], folder)


def on_verilator(folder: Path, sources: Sequence[Path], **parameters: int) -> list[str]:
    given = [f"-G{name}={value}" for name, value in parameters.items()]
    command = ["verilator", "--binary", "--timing", "-Wno-fatal", "-O0", "--top-module", "tb_icap_read", *given]
    command += ["-Mdir", str(folder / "obj"), *map(str, sources)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return output([str(folder / "obj/Vtb_icap_read")], folder)


def output(command: Sequence[str], folder: Path) -> list[str]:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return [line for line in done.stdout.splitlines() if line.split()[0] in ("word", "status", "hung")]


def frames(seed: int, count: int, size: int) -> list[int]:
    source = random.Random(seed)
    return [source.getrandbits(32) for _ in range(count * size)]


@pytest.mark.parametrize(("ultrascale", "size", "pipeline"), [(0, 101, 0), (1, 93, 25)])
@pytest.mark.parametrize("simulator", ["icarus", "verilator"])
def test_both_simulators_give_the_same(
    simulator: str, ultrascale: int, size: int, pipeline: int, tmp_path: Path
) -> None:
    if shutil.which("verilator" if simulator == "verilator" else "iverilog") is None:
        pytest.skip(f"needs {simulator}, which is not installed")
    data = frames(1, 3, size)
    load = [SYNC, NOP, 0x30008001, 7, 0x30002001, 9, 0x30008001, 1, 0x30004000, 0x50000000 | (len(data) + size)]
    count = pipeline + 4 * size
    ask = [SYNC, NOP, 0x30008001, 4, 0x30002001, 9, 0x28006000, 0x48000000 | count, *[NOP] * 64]
    load += [*data, *[0] * size, *DESYNC]
    packets = [(load, False), (ask, True), (DESYNC, False), (ask, True), (DESYNC, False)]
    given = lines(packets)
    (tmp_path / "words.hex").write_text("\n".join(given) + "\n")
    sources = [HERE / "tb/tb_icap_read.v", READ, *MODELS]
    runs = {"icarus": on_icarus, "verilator": on_verilator}
    said = runs[simulator](tmp_path, sources, ULTRASCALE=ultrascale, COUNT=len(given))
    answers = [line.split()[1:] for line in said if line.startswith("word")]
    assert said[-1] == "status 001"
    assert len(answers) == 2 * count
    for answer in (answers[:count], answers[count:]):
        assert [int(word, 16) for word, _ in answer[pipeline + size :]] == data
        assert [last for _, last in answer] == ["0"] * (count - 1) + ["1"]


@pytest.mark.skipif("CM_UNISIM" not in os.environ, reason="needs CM_UNISIM: the vendor's simulation models")
@pytest.mark.parametrize(("primitive", "idcode"), [("ICAPE2", "03651093"), ("ICAPE3", "03628093")])  # their defaults
def test_the_vendors_port_answers_with_its_idcode(primitive: str, idcode: str, tmp_path: Path) -> None:
    folder = Path(os.environ["CM_UNISIM"])
    sources = [HERE / "tb/tb_icap_read.v", READ]
    for name in ("ICAPE2", "SIM_CONFIGE2", "ICAPE3", "SIM_CONFIGE3", "glbl"):
        text = next(folder.rglob(f"{name}.v")).read_text(errors="replace")
        # Icarus Verilog takes no drive strength with a range
        (tmp_path / f"{name}.v").write_text(re.sub(r"tri \(\w+, \w+\) \[31:0\]", "tri [31:0]", text))
        sources.append(tmp_path / f"{name}.v")
    ask = [0xFFFFFFFF, SYNC, NOP, NOP, 0x28018001, NOP, NOP]
    given = lines([(ask, True), (DESYNC, False), (ask, True), (DESYNC, False)])
    (tmp_path / "words.hex").write_text("\n".join(given) + "\n")
    said = on_icarus(tmp_path, sources, ULTRASCALE=int(primitive == "ICAPE3"), COUNT=len(given), START=10_000_000)
    assert [line for line in said if line.startswith("word")] == [f"word {idcode} 1"] * 2
