# SPDX-License-Identifier: Apache-2.0
"""Situations that users of peers reported, tried here: a test's name has the numbers of the issues.

They are of Xilinx/PYNQ, zeromq/pyzmq, Koheron/koheron-sdk, strath-sdr/rfsoc_qpsk (39), and
dspsandbox/FPGA-Notes-for-Scientists (7).
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from manager_process import CAMERA, Manager, environment, served, until

import cm
from cm.client.errors import RequestFailed
from cm.errors import CmError
from cm.formats import fdt
from cm.manager.errors import BadOverlay
from cm.schema import loads
from cm.schema.model import Overlay
from cm.schema.named_files import bitstream_path
from cm.server.bitstream_and_overlay_files import BoardFiles


@pytest.fixture(scope="module")
def manager() -> Iterator[Manager]:
    with served() as (started, _):
        yield started


@pytest.fixture
def board(manager: Manager) -> Iterator[cm.Board]:
    with manager.connected() as connected:
        connected.load("camera", "loopback", force=True)
        yield connected


def script(text: str, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", text, *words]
    return subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=60, check=False)


def test_pynq_1652_a_register_that_a_rebuild_moved_is_found_where_it_is_now(tmp_path: Path) -> None:
    """Not where a description of the build before has it."""
    text = (CAMERA / "camera.yaml").read_text("utf-8")
    schema = tmp_path / "camera.yaml"
    schema.write_text(text)
    with served(schemas=tmp_path) as (own, _), own.connected() as board:
        board.load("camera", "default")
        board.registers["scratch"] = 5
        now = "before: {offset: 0x14}\n        scratch:\n          offset: 0x1c\n"
        moved = text.replace("scratch:\n          offset: 0x14\n", now)
        assert moved != text
        schema.write_text(moved)
        os.kill(own.pid, signal.SIGHUP)

        def renewed() -> bool:
            board.load("camera", "default", force=True)
            return "before" in {one.name for one in board.config().registers}

        until(renewed)
        board.registers["scratch"] = 9
        assert board.registers.read("before", "scratch") == {"before": 5, "scratch": 9}


def test_pynq_110_a_stream_that_was_made_before_a_load_works_after_it(board: cm.Board) -> None:
    with board.stream("camera", timeout=60) as stream:
        for mode in ("default", "edge_detection"):
            board.load("camera", mode)
            assert mode in {frame.info.mode for _, frame in zip(range(60), stream, strict=False)}


def test_pynq_845_a_reader_may_wait_before_anything_is_sent(board: cm.Board) -> None:
    sent = np.full((480, 640), 7, np.uint8)
    with board.stream("from_pl", timeout=60) as stream:
        later = threading.Timer(0.5, board.write, ("to_pl", sent))
        later.start()
        assert np.array_equal(stream.read(), sent)
        later.join()


def test_pynq_846_a_frame_of_another_size_is_refused_with_both_sizes(board: cm.Board) -> None:
    with pytest.raises(RequestFailed, match=r"307200.*273280|273280.*307200|480.*427|427.*480"):
        board.write("to_pl", np.zeros((427, 640), np.uint8))
    waiting = """
import signal, sys, cm
with cm.connect(runtime_dir=sys.argv[1]) as board, board.stream("from_pl", timeout=None) as stream:
    try:
        print("waits", flush=True)
        stream.read()
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        print("interrupted", board.status.config_name)
"""
    command = [sys.executable, "-c", waiting, str(board_folder(board))]
    process = subprocess.Popen(command, env=environment(), stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "waits\n"

    def interrupted() -> bool:  # again, as a signal just before the system call that waits is seen behind it only
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(1)
        return process.returncode is not None

    until(interrupted)
    assert process.communicate()[0] == "interrupted camera\n"


def board_folder(board: cm.Board) -> Path:
    """The runtime folder of its manager."""
    return Path(repr(board).partition("ipc://")[2].partition("/req")[0])


UNANSWERED = """
import os, sys, time, zmq
folder = sys.argv[1]
context = zmq.Context()
silent = [context.socket(kind) for kind in (zmq.ROUTER, zmq.PUB)]
for socket, name in zip(silent, ("req", "pub")):
    socket.bind(f"ipc://{folder}/{name}")
import cm
board = cm.Board(runtime_dir=folder, timeout=0.5)  # connect() asks at once
try:
    board.status
except cm.errors.CmError as error:
    print(type(error).__name__)
if sys.argv[2] == "close":
    board.close()
print("end", flush=True)
context.destroy(linger=0)
"""


@pytest.mark.parametrize("how", ["close", "exit"])
def test_pyzmq_102_and_1003_a_request_without_an_answer_holds_up_no_end(how: str, tmp_path: Path) -> None:
    done = script(UNANSWERED, str(tmp_path), how)
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "end"), done.stderr


FORKS = """
import gc, os, sys, warnings, cm
warnings.simplefilter("ignore", DeprecationWarning)  # Python 3.12 says so of any fork beside a thread
board = cm.connect(runtime_dir=sys.argv[1])
first = board.status.board
child = os.fork()
if not child:
    del board
    gc.collect()
    sys.exit(7)
status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
print(status, board.status.board == first)
"""


def test_pyzmq_222_a_forked_child_that_collects_its_garbage_ends_and_the_parent_goes_on(manager: Manager) -> None:
    done = script(FORKS, str(manager.runtime))
    assert (done.stdout, done.stderr) == ("7 True\n", "")


SCHEMA = """
config:
  name: c
  type: full
  bitstream: ours.bit
  modes: {m: {}}
"""


def test_koheron_sdk_523_an_overlay_whose_firmware_name_is_only_a_suffix_is_refused(tmp_path: Path) -> None:
    own = tmp_path / "own"
    own.mkdir()
    config = loads(SCHEMA, source=own / "c.yaml")
    node = fdt.FdtNode("", {"firmware-name": b".bin\0"}, [])
    (own / "pl.dtbo").write_bytes(fdt.pack(fdt.overlay("/fpga-full", node)))
    with pytest.raises(BadOverlay, match=r"\.bin"):
        BoardFiles(tmp_path / "root").overlay(config, Overlay("pl"), [])


def test_rfsoc_qpsk_39_a_bitstream_that_was_copied_in_part_is_refused_before_the_first_step(tmp_path: Path) -> None:
    with served() as (own, sim), own.connected() as board:
        board.load("camera", "default")
        (file,) = Path(sim.root).rglob("edge.bit")
        whole = file.read_bytes()
        file.unlink()
        file.write_bytes(whole[: len(whole) // 2])
        with pytest.raises(CmError, match=r"edge\.bit, of module edge of region prr0 in camera: ") as refused:
            board.set_mode("edge_detection")
        assert (refused.value.code, board.mode) == ("bitstream_truncated", "default")
        file.write_bytes(whole)
        board.set_mode("edge_detection")


def test_fpga_notes_7_of_two_files_of_a_name_the_one_beside_the_schema_is_taken(tmp_path: Path) -> None:
    config = loads("config: {name: c, modules: [led], modes: {m: {}}}", source=tmp_path / "c.yaml")
    there = tmp_path / "root/lib/firmware"
    for folder in (tmp_path, there):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "led.bit").touch()
    assert bitstream_path(config, "led", tmp_path / "root") == tmp_path / "led.bit"
