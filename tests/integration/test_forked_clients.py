# SPDX-License-Identifier: Apache-2.0
"""A program forks under an open client: what is open stays its own, whatever its children do.

In processes of their own, as pytest's has threads.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from manager_process import Manager, environment

import cm

_BEGIN = """
import gc, multiprocessing, os, sys, threading, traceback, warnings
warnings.simplefilter("ignore")  # newer Pythons warn of forks beside threads
import numpy as np
import cm
from cm.client.errors import BoardClosed

where = sys.argv[1]

def in_a_child(work, end=os._exit):
    sys.stdout.flush()
    child = os.fork()
    if not child:
        status = 1
        try:
            work()
            status = 0
        except BaseException:
            traceback.print_exc()
        end(status)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0

def refused(work):
    try:
        work()
    except BoardClosed as error:
        assert "forked from" in str(error), error
    else:
        raise AssertionError("it worked")

board = cm.connect(runtime_dir=where, timeout=60)
"""

_READER = """
stream = board.stream("camera", timeout=60)
held = [stream.read() for _ in range(3)]
same = [frame.tobytes() for frame in held]

def child():
    global held, stream
    for ask in (lambda: board.status, stream.read, stream.poll, lambda: board.stream("camera").read()):
        refused(ask)
    assert held[0].tobytes() == same[0]
    held[1].release()
    del held
    stream.close()
    del stream
    board.close()
    gc.collect()

for end in (os._exit, sys.exit):
    in_a_child(child, end)
(mine,) = [c for s in board.status.streams for c in s.clients if c.pid == os.getpid()]
assert mine.held >= 3, mine
for _ in range(20):
    stream.read()
assert [frame.tobytes() for frame in held] == same
"""

_WRITER = """
board.mode = "loopback"
picture = np.ones((480, 640), np.uint8)
with board.stream("from_pl", timeout=60) as back, board.writer("to_pl", timeout=60) as writer:
    with writer.slot() as slot:
        slot[...] = picture

        def child():
            global slot
            refused(lambda: writer.write(picture))
            refused(writer.flush)
            del slot
            writer.close()

        in_a_child(child, sys.exit)
    writer.flush()
    assert (back.read() == picture).all()
board.mode = "default"
"""

_MEMORY = """
array = board.allocate(4096)
array[:] = 7

def child():
    global array
    array.free()
    del array
    gc.collect()

in_a_child(child, sys.exit)
(mine,) = [c for c in board.clients() if c.name.startswith(f"pid {os.getpid()} ")]
assert mine.memory_bytes == 4096, mine
array.sync_to_device()
"""

_EVENTS = """
waiting = threading.Event()
events = board.registers.events("focus", timeout=60)

def wait():
    waiting.set()
    got.append(events.next().values[0].value)

got = []
thread = threading.Thread(target=wait)
thread.start()
waiting.wait()

def child():
    refused(events.next)
    refused(lambda: board.registers["focus"])
    events.close()
    board.close()
    with cm.connect(runtime_dir=where, timeout=60) as own:
        own.registers["focus"] = 5

in_a_child(child, sys.exit)
thread.join()
assert got == [5], got
"""

_LEASE = """
with board.lease("registers:focus", seconds=60) as lease:

    def child():
        refused(lease.release)

    in_a_child(child)
    assert [held.scope for held in board.status.leases] == ["registers:focus"]
"""

_POOL = """
def mode(_):
    with cm.connect(runtime_dir=where, timeout=60) as own:
        try:
            own.registers["focsu"]
        except cm.CmError as error:
            refused(lambda: board.status)
            raise

stream = board.stream("camera", timeout=60)
frame = stream.read()
with multiprocessing.get_context("fork").Pool(2) as pool:
    for result in [pool.apply_async(mode, (n,)) for n in range(4)]:
        try:
            result.get(60)
        except cm.errors.NotFound as error:
            assert error.code == "unknown_register" and "focus" in str(error)
        else:
            raise AssertionError("there is no such register")
    means = pool.map(np.mean, [frame, frame.astype("f4")])
assert means[0] == frame.mean()
assert stream.read().sequence > frame.sequence
"""

_ASYNCIO = """
import asyncio, cm.aio

async def main():
    async with cm.aio.connect(runtime_dir=where, timeout=60) as own, own.stream("camera", timeout=60) as frames:
        frame = await frames.read()
        same = frame.tobytes()

        def child():
            nonlocal frame
            try:
                own.status().send(None)
            except BoardClosed as error:
                assert "forked from" in str(error)
            del frame
            gc.collect()

        in_a_child(child)
        for _ in range(10):
            await frames.read()
        assert frame.tobytes() == same

asyncio.run(main())
"""


@pytest.mark.parametrize(
    "script",
    [_READER, _WRITER, _MEMORY, _EVENTS, _LEASE, _POOL, _ASYNCIO],
    ids=["reader", "writer", "memory", "events", "lease", "pool", "asyncio"],
)
def test_what_a_process_has_opened_is_left_alone_by_its_children(
    board: cm.Board, manager: Manager, script: str, tmp_path: Path
) -> None:
    path = tmp_path / "program.py"
    path.write_text(f"{_BEGIN}\n{script}\nprint('done')\n")
    done = subprocess.run(
        [sys.executable, path, str(manager.runtime)],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
        env=environment(),
    )
    assert (done.returncode, done.stdout.splitlines()[-1:]) == (0, ["done"]), done.stderr
    assert done.stderr == ""


def test_a_board_is_not_sent_to_another_process(board: cm.Board) -> None:
    for what in (board, board.registers, board.interrupts["frame_done"], board.memories["scratchpad"]):
        with pytest.raises(TypeError, match=r"neither pickled nor copied: connect\(\)"):
            pickle.dumps(what)


def test_views_of_frames_are_pickled_without_what_is_known_of_the_frame(board: cm.Board) -> None:
    for copies in (False, True):
        with board.stream("camera", timeout=60, copy=copies) as frames:
            view = frames.read().astype("float32")
            with warnings.catch_warnings(), pytest.raises(AttributeError, match="ask the frame"):
                _ = view.info
            assert (pickle.loads(pickle.dumps(view)) == view).all()
