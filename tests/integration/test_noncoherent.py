# SPDX-License-Identifier: Apache-2.0
"""Non-coherent memory: taking and releasing a frame each have exactly one DMA_BUF_IOCTL_SYNC.

The simulated board keeps the device's view of each buffer apart from the processor's; a preloaded library stands in
for the ioctl and copies between them (`csrc/tests/sim_dma_buf.c`). Manager and clients run unchanged, in separate
processes: one that omits a call sees or sends old bytes.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from manager_process import REPOSITORY, Manager, environment, served, until

from cm.simulation.software import Board as SimBoard

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="needs_c_tools: cc is not installed")

PRELUDE = """
import json, sys
import numpy as np
import cm
from itertools import islice
board = cm.connect(runtime_dir=sys.argv[1], timeout=60)
PICTURE = np.arange(480 * 640, dtype=np.uint32).astype(np.uint8).reshape(480, 640)
def tell(**what): print(json.dumps(what))
"""


class Setup:
    """A manager and its board, and how clients are run beside them."""

    def __init__(self, manager: Manager, sim: SimBoard, env: dict[str, str]) -> None:
        self.manager, self.sim, self.env = manager, sim, env

    def run(self, body: str) -> dict[str, Any]:
        """The output of a client that runs `body`."""
        command = [sys.executable, "-W", "error", "-c", PRELUDE + textwrap.dedent(body), str(self.manager.runtime)]
        done = subprocess.run(command, check=False, capture_output=True, text=True, env=self.env, timeout=120)
        assert done.returncode == 0, done.stderr
        told: dict[str, Any] = json.loads(done.stdout) if done.stdout else {}
        return told

    def load(self, *modes: str) -> None:
        """Enter modes, one after the other."""
        with self.manager.connected() as board:
            for mode in modes:
                board.load("camera", mode)

    def counts(self, channel: str) -> dict[str, int]:
        """The board's counts, once nobody uses the streams any more."""
        until(lambda: not any(c["open"] for c in self.sim.control.state()["channels"].values()))
        counts: dict[str, int] = self.sim.control.state()["syncs"][channel]
        return counts

    def added(self, channel: str, before: dict[str, int]) -> dict[str, int]:
        """The increase of a channel's counts, without zeros."""
        now = self.counts(channel)
        return {name: value - before[name] for name, value in now.items() if value != before[name]}


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The stand-in for the ioctl."""
    library = tmp_path_factory.mktemp("preload") / "sim_dma_buf.so"
    source = REPOSITORY / "csrc" / "tests" / "sim_dma_buf.c"
    flags = ["-D_GNU_SOURCE", "-std=gnu11", "-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "-o", library, source, "-ldl"], check=True)
    return library


@pytest.fixture(scope="module")
def apart(library: Path) -> Iterator[Setup]:
    """A board whose memory is not coherent, the camera example loaded."""
    env = {**environment(), "LD_PRELOAD": str(library)}
    with served(["--non-coherent", "--rate", "100"], env=env) as (manager, sim):
        setup = Setup(manager, sim, env)
        setup.load("default")
        yield setup


def loop(setup: Setup, body: str) -> tuple[dict[str, Any], dict[str, int], dict[str, int]]:
    """The output of a client that runs `body` on the loop, and the increase of both channels' counts."""
    setup.load("loopback")
    before = setup.counts("to_pl"), setup.counts("from_pl")
    told = setup.run(body)
    added = setup.added("to_pl", before[0]), setup.added("from_pl", before[1])
    return told, *added


def test_a_reader_that_does_not_synchronise_sees_old_bytes(apart: Setup) -> None:
    """Without this, the other tests of this file would show nothing."""
    told, _, _ = loop(
        apart,
        """
        from cm.client import mapping
        mapping.SlotMappings._sync = lambda *_: None
        with board.stream("from_pl", timeout=60) as reader:
            board.write("to_pl", PICTURE)
            tell(same=bool((reader.read() == PICTURE).all()))
        """,
    )
    assert told == {"same": False}


def test_frames_that_are_never_read_cost_nothing(apart: Setup) -> None:
    before = apart.counts("camera")
    apart.run(
        """
        with board.stream("camera", depth=4, timeout=60) as slow, board.stream("camera", timeout=60) as quick:
            first = slow.read()
            for frame in islice(quick, 10):
                pass
        """
    )
    assert apart.added("camera", before) == {"read_starts": 11, "read_ends": 11}


def test_the_newest_frame_costs_what_it_skips(apart: Setup) -> None:
    before = apart.counts("camera")
    told = apart.run(
        """
        with board.stream("camera", 60, newest=True) as newest, board.stream("camera", 60) as all_frames:
            taken = []
            for _ in range(3):
                taken.append(newest.read().sequence)
                list(islice(all_frames, 3))
        tell(taken=taken)
        """
    )
    added = apart.added("camera", before)
    assert added["read_starts"] == added["read_ends"] >= 12
    assert set(added) == {"read_starts", "read_ends"}
    assert told["taken"] == sorted(set(told["taken"]))


def test_what_a_writer_fills_arrives_and_each_slot_is_synchronised_once(apart: Setup) -> None:
    told, to_pl, from_pl = loop(
        apart,
        """
        same = 0
        with board.stream("from_pl", timeout=60) as reader, board.writer("to_pl", depth=3, timeout=60) as writer:
            for number in range(12):
                with writer.slot() as array:
                    array[...] = PICTURE + number
                same += bool((reader.read() == (PICTURE + number).astype(np.uint8)).all())
            try:
                with writer.slot() as array:
                    raise KeyError
            except KeyError:
                pass
        tell(same=same)
        """,
    )
    assert told == {"same": 12}
    assert to_pl == {"write_starts": 13, "write_ends": 13}
    assert from_pl == {"read_starts": 12, "read_ends": 12}


def test_lines_apart_are_synchronised_as_well(apart: Setup) -> None:
    told, to_pl, from_pl = loop(
        apart,
        """
        for name in ("to_pl", "from_pl"):
            board.configure_stream(name, stride=700)
        with board.stream("from_pl", timeout=60) as reader:
            board.write("to_pl", PICTURE)
            with board.writer("to_pl", timeout=60) as writer:
                first = bool((reader.read() == PICTURE).all())
                writer.write(PICTURE[::-1])
                tell(same=[first, bool((reader.read() == PICTURE[::-1]).all())])
        """,
    )
    assert told == {"same": [True, True]}
    assert (to_pl, from_pl) == ({"write_starts": 2, "write_ends": 2}, {"read_starts": 2, "read_ends": 2})


def test_zeromq_reads_and_writes_are_synchronised_by_the_manager(apart: Setup) -> None:
    told, to_pl, from_pl = loop(
        apart,
        """
        from dataclasses import replace
        board._place = replace(board._place, data=None)
        with board.stream("from_pl", timeout=60) as reader:
            while not next(s for s in board.status.streams if s.name == "from_pl").open:
                pass
            same = []
            for number in range(5):
                sent = (PICTURE + number).astype(np.uint8)
                board.write("to_pl", sent)
                same.append(bool((reader.read() == sent).all()))
        tell(same=same)
        """,
    )
    assert told == {"same": [True] * 5}
    assert (to_pl, from_pl) == ({"write_starts": 5, "write_ends": 5}, {"read_starts": 5, "read_ends": 5})


def test_all_subscribers_share_one_reader_and_each_local_reader_has_its_own(apart: Setup) -> None:
    _, _, from_pl = loop(
        apart,
        """
        from contextlib import ExitStack
        from dataclasses import replace
        far = cm.connect(runtime_dir=sys.argv[1], timeout=60)
        far._place = replace(far._place, data=None)
        with ExitStack() as stack:
            remote = [stack.enter_context(far.stream("from_pl", timeout=60)) for _ in range(3)]
            while not next(s for s in board.status.streams if s.name == "from_pl").clients:
                pass
            local = [stack.enter_context(board.stream("from_pl", timeout=60)) for _ in range(2)]
            for number in range(4):
                board.write("to_pl", PICTURE)
                assert all((reader.read() == PICTURE).all() for reader in remote + local)
        """,
    )
    assert from_pl == {"read_starts": 12, "read_ends": 12}


def test_what_is_held_when_its_stream_stops_is_synchronised_when_it_is_given_back(apart: Setup) -> None:
    before = apart.counts("camera")
    told = apart.run(
        """
        with board.stream("camera", timeout=60) as stream:
            held = [stream.read() for _ in range(3)]
            contents = [frame.copy() for frame in held]
            board.mode = "edge_detection"
            edges = next(f for f in stream if f.info.mode == "edge_detection").copy()
            same = all((a == b).all() for a, b in zip(held, contents))
            held.clear()
            last = stream.read()
        kept = last.copy()
        same = same and bool((last == kept).all())
        del last
        board.mode = "default"
        tell(same=bool(same), edges=float(edges.mean()))
        """
    )
    assert told["same"]
    assert told["edges"] > 0
    added = apart.added("camera", before)
    assert added.pop("read_starts") == added.pop("read_ends") >= 5
    assert not added, "unpaired, held, early, or written"


def test_a_writer_whose_stream_stops_ends_the_access_that_it_began(apart: Setup) -> None:
    _, to_pl, _ = loop(
        apart,
        """
        with board.writer("to_pl", timeout=60) as writer, writer.slot() as array:
            board.configure_stream("to_pl", slots=6, force=True)
            array[...] = 1
        """,
    )
    assert to_pl == {"write_starts": 1, "write_ends": 1}


def test_bitstreams_reach_the_port(apart: Setup) -> None:
    before = apart.counts("icap")
    apart.load("colorise", "default")
    added = apart.added("icap", before)
    assert added.get("write_starts", 0) == added.get("write_ends", 0)
    assert not added.keys() - {"write_starts", "write_ends"}


@pytest.fixture(scope="module")
def examples(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with examples of the pages, linked with what `make -C csrc/client` makes."""
    client, folder = REPOSITORY / "csrc/client", tmp_path_factory.mktemp("examples")
    library = folder / "libcm_plane.a"
    subprocess.run(["make", "-s", "-j2", "-C", client, library, f"BUILD={folder}"], check=True, capture_output=True)
    for name in ("reader", "writer"):
        source = REPOSITORY / f"docs/examples/{name}.c"
        subprocess.run(["cc", f"-I{client}", "-o", folder / name, source, library], check=True)
    return folder


def test_the_c_library_synchronises_what_it_takes(apart: Setup, examples: Path) -> None:
    before = apart.counts("camera")
    command = [examples / "reader", apart.manager.runtime, "camera", "7"]
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=apart.env, timeout=60)
    assert done.returncode == 0, done.stderr
    means = [float(line.rpartition(" ")[2]) for line in done.stdout.splitlines()[:7]]
    assert all(mean not in (0.0, 197.0) for mean in means), "not what the device wrote: 0, or 0xC5"
    assert apart.added("camera", before) == {"read_starts": 7, "read_ends": 7}


def test_the_c_librarys_writer_synchronises_what_it_fills(apart: Setup, examples: Path) -> None:
    program = examples / "writer"
    told, to_pl, from_pl = loop(
        apart,
        f"""
        import subprocess
        with board.stream("from_pl", depth=8, timeout=60) as reader:
            subprocess.run([{str(program)!r}, sys.argv[1], "to_pl", "6"], check=True, stdout=subprocess.DEVNULL)
            tell(same=[bool((reader.read() == number).all()) for number in range(6)])
        """,
    )
    assert told == {"same": [True] * 6}
    assert (to_pl, from_pl) == ({"write_starts": 6, "write_ends": 6}, {"read_starts": 6, "read_ends": 6})


def test_coherent_memory_is_never_synchronised(library: Path, tmp_path: Path) -> None:
    log = tmp_path / "ioctls"
    env = {**environment(), "LD_PRELOAD": str(library), "SIM_DMA_BUF_LOG": str(log)}
    with served(env=env) as (manager, sim):
        setup = Setup(manager, sim, env)
        setup.run(
            """
            board.load("camera", "loopback")
            with board.stream("from_pl", timeout=60) as reader, board.writer("to_pl", timeout=60) as writer:
                writer.write(PICTURE)
                assert (reader.read() == PICTURE).all()
                board.write("to_pl", PICTURE)
                assert (reader.read() == PICTURE).all()
            board.read("camera", timeout=60)
            """
        )
        assert sim.control.state()["syncs"] == {}
    assert not log.exists(), f"{log.read_text().count(os.linesep)} needless calls"


def test_a_region_is_compared_through_memory_that_is_synchronised(apart: Setup) -> None:
    """Old bytes would be a frame of noise, or all frames wrong: the buffers are used again and again."""
    before = apart.counts("icap")
    with apart.manager.connected() as board:
        board.load("camera", "default", force=True)
        found = [board.check_region("prr0") for _ in range(3)]
    assert [one.verdict for one in found] == ["good"] * 3
    assert min(one.frames for one in found) > 600
    added = apart.added("icap", before)
    assert added["read_starts"] == added["read_ends"] >= 3
    assert "early" not in added
