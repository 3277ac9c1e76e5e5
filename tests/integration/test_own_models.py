# SPDX-License-Identifier: Apache-2.0
"""Users' models on the simulated board: the documented filter, a kernel with m_axi, several streams."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from manager_process import REPOSITORY, environment, served, until

import cm
from cm import child
from cm.errors import Timeout

DOCS = REPOSITORY / "docs"

KERNEL = """
config:
  name: kernel
  modules:
    vadd:
      mmio:
        - base_address: 0x43c00000
          registers:
            start: {offset: 0x0, fields: {go: {bits: 0}}}
            state: {offset: 0x4, access: ro, volatile: true}
            first: {offset: 0x10}
            second: {offset: 0x18}
            sum: {offset: 0x20}
            count: {offset: 0x28}
            status: {offset: 0x30, access: w1c, volatile: true, fields: {done: {bits: 0}}}
  interrupts:
    done: {base_address: 0x43c00000, status: status, bit: 0, acknowledge: true}
  streams:
    low: {direction: s2mm, shape: [4], dtype: uint32}
    high: {direction: s2mm, shape: [2], dtype: uint32}
    values: {direction: mm2s}
  modes:
    vadd: {modules: [vadd]}
"""

VADD = '''
import numpy as np
from cm.simulation.software import Model


class Vadd(Model):
    """sum[i] = first[i] + second[i], some time after `start`; what comes in is sent on by size."""

    outputs = ("low", "high")

    def written(self, register, value):
        if register == "start" and value & 1:
            self.registers["state"] = 1
            self.board.after(0.01, self.work)

    def work(self):
        length = 4 * self.registers["count"]
        places = [self.registers[name] for name in ("first", "second", "sum")]
        one, other, result = (self.board.memory(place, length).view("<u4") for place in places)
        np.add(one, other, out=result)
        self.registers["start"] = 0
        self.registers["state"] = 2
        self.board.interrupt("done")

    def frame(self, stream, frame):
        values = frame.reshape(-1).view("<u4")
        self.board.send("low", np.sort(values)[:4])
        self.board.send("high", np.sort(values)[-2:])
        return None


MODELS = {"vadd": Vadd}
'''


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture(scope="module")
def fir(tmp_path_factory: pytest.TempPathFactory) -> Iterator[cm.Board]:
    """The schema of docs/schema.md with the model of docs/simulator.md."""
    folder = tmp_path_factory.mktemp("fir")
    [schema] = [text for text in blocks("schema.md", "yaml") if "coefficients:" in text]
    [model] = [text for text in blocks("simulator.md", "python") if "class Fir" in text]
    (folder / "filter.yaml").write_text(schema)
    (folder / "fir.py").write_text(model)
    with (
        served(["--models", str(folder / "fir.py")], schemas=folder / "filter.yaml") as (manager, _),
        manager.connected() as board,
    ):
        board.load("filter")
        yield board


def test_the_documented_filter_filters_with_what_was_committed(fir: cm.Board) -> None:
    taps = np.zeros((32, 64), np.int16)
    taps[3, :3] = [128, 64, 32]
    fir.memories["coefficients"].write(taps)
    samples = (np.arange(4096) % 251).astype(np.uint8)
    with fir.stream("from_pl", timeout=30) as results:
        results.open()
        until(lambda: next(s for s in fir.status.streams if s.name == "from_pl").open)
        fir.write("to_pl", samples)
        assert not results.read().any(), "nothing was committed yet"
        fir.registers["commit"] = 3
        fir.write("to_pl", samples)
        expected = np.convolve(samples.astype(np.int64), taps[3])[: samples.size]
        assert (results.read() == (expected >> 8)).all()
        assert (fir.memories["trace"].read() == expected[-2048:]).all()


def test_a_load_gives_a_filter_that_knows_nothing(fir: cm.Board) -> None:
    fir.registers["commit"] = 3
    fir.load("filter", force=True)
    with fir.stream("from_pl", timeout=30) as results:
        results.open()
        until(lambda: next(s for s in fir.status.streams if s.name == "from_pl").open)
        fir.write("to_pl", np.full(1000, 9, np.uint8))
        assert not results.read().any()


@pytest.fixture(scope="module")
def kernel(tmp_path_factory: pytest.TempPathFactory) -> Iterator[cm.Board]:
    folder = tmp_path_factory.mktemp("kernel")
    (folder / "kernel.yaml").write_text(KERNEL)
    (folder / "vadd.py").write_text(VADD)
    with (
        served(["--models", str(folder / "vadd.py")], schemas=folder / "kernel.yaml") as (manager, _),
        manager.connected() as board,
    ):
        board.load("kernel")
        yield board


def test_a_kernel_works_on_memory_by_its_address_and_raises_its_interrupt(kernel: cm.Board) -> None:
    first, second, result = (kernel.allocate(1000, "uint32") for _ in range(3))
    first[...], second[...] = np.arange(1000), 7
    places = {"first": first.device_address, "second": second[0:].device_address, "sum": result.device_address}
    with kernel.interrupts["done"].events(timeout=30) as done:
        kernel.registers.write({**places, "count": 1000, "start.go": 1})
        assert done.next().count == 1
    assert (result == np.arange(1000) + 7).all()
    assert kernel.registers.read("start", "state") == {"start": 0, "state": 2}


def test_a_kernel_given_an_address_without_memory_stops_and_the_board_goes_on(kernel: cm.Board) -> None:
    kernel.registers.write({"first": 0x1000, "second": 0x1000, "sum": 0x1000, "count": 4, "start.go": 1})
    with kernel.interrupts["done"].events() as done, pytest.raises(Timeout):
        done.next(timeout=0.3)
    assert kernel.registers["state"] == 1
    kernel.load("kernel", force=True)
    assert kernel.registers["state"] == 0


def test_one_stream_in_is_two_streams_out(kernel: cm.Board) -> None:
    with kernel.stream("low", timeout=30) as low, kernel.stream("high", timeout=30) as high:
        low.open()
        high.open()
        until(lambda: all(s.open for s in kernel.status.streams if s.direction == "s2mm"))
        kernel.write("values", np.array([9, 1, 8, 2, 7, 3], np.uint32))
        assert (low.read().tolist(), high.read().tolist()) == ([1, 2, 3, 7], [8, 9])


def test_an_unknown_model_is_an_error_that_lists_the_known_ones(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("MODELS = {'fir': lambda frame, registers: frame}")
    command = child.command("cm.cli.main", "serve", "--sim", "--config", "one.yaml", "--models", "mine.py")
    places = ["--runtime-dir", str(tmp_path / "run"), "--state-dir", str(tmp_path / "state")]
    for modules, says in (
        ("fir: {model: fri}", "no model is called 'fri', did you mean 'fir'?"),
        ("fir: {model: fir}, turn_prr0: {model: turn}", "ready at"),  # `cm build` names one of several regions
    ):
        (tmp_path / "one.yaml").write_text(
            f"config: {{name: one, modules: {{{modules}}}, modes: {{a: {{modules: [fir]}}}}}}"
        )
        with subprocess.Popen([*command, *places], stderr=subprocess.PIPE, env=environment(), cwd=tmp_path) as served_:
            assert served_.stderr is not None
            told = served_.stderr.readline().decode()
            served_.terminate()
            told += served_.stderr.read().decode()
        assert says in told
        assert says == "ready at" or "colorise, default, edge, fir" in told
