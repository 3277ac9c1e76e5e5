# SPDX-License-Identifier: Apache-2.0
"""The event loop of the daemon and of the simulated board: descriptors, timers and calls."""

from __future__ import annotations

import logging
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial

import pytest

from cm.loop import Loop
from cm.server.sockets import Loop as DaemonLoop

WAIT = 20.0


@pytest.fixture(params=[Loop, DaemonLoop])
def loop(request: pytest.FixtureRequest) -> Iterator[Loop]:
    made = request.param()
    yield made
    made.close()


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    one.setblocking(False)
    with one, other:
        yield one, other


@pytest.fixture
def beside(loop: Loop) -> Iterator[Callable[[], threading.Thread]]:
    """Start the loop in a separate thread."""
    threads: list[threading.Thread] = []

    def start() -> threading.Thread:
        threads.append(threading.Thread(target=loop.run))
        threads[-1].start()
        return threads[-1]

    yield start
    loop.stop()
    for thread in threads:
        thread.join(WAIT)
        assert not thread.is_alive()


def test_timers_are_called_by_their_time_and_then_by_their_order(loop: Loop) -> None:
    seen: list[str] = []
    now = time.monotonic()
    loop.call_at(now + 0.02, loop.stop)
    for due, name in ((0.01, "c"), (-1.0, "a"), (0.01, "d"), (-0.5, "b")):
        loop.call_at(now + due, lambda name=name: seen.append(name))
    loop.run()
    assert seen == ["a", "b", "c", "d"]
    assert time.monotonic() - now >= 0.02


def test_a_cancelled_timer_is_not_called(loop: Loop) -> None:
    seen: list[str] = []
    timer = loop.call_later(0.0, lambda: seen.append("cancelled"))
    timer.cancel()
    timer.cancel()
    loop.call_later(0.001, loop.stop)
    loop.run()
    assert seen == []


def test_every_calls_repeatedly(loop: Loop) -> None:
    seen: list[int] = []
    loop.every(0.0, lambda: (seen.append(len(seen)), len(seen) == 3 and loop.stop()))
    loop.run()
    assert seen == [0, 1, 2]


def test_a_call_is_made_before_the_next_wait_and_lets_others_have_their_turn(loop: Loop, pair) -> None:
    ours, theirs = pair
    seen: list[str] = []

    def again() -> None:
        seen.append("call")
        loop.call_soon(again)

    loop.add(ours.fileno(), lambda: (seen.append(ours.recv(1).decode()), loop.stop()))
    loop.call_soon(again)
    theirs.send(b"x")
    loop.run()
    assert seen[:2] == ["call", "x"]


def test_listeners_are_served_after_all_others_of_the_round(loop: Loop) -> None:
    seen: list[str] = []
    pipes = [os.pipe() for _ in range(6)]

    def ready(fd: int, kind: str) -> None:
        seen.append(kind)
        loop.remove(fd)
        if len(seen) == len(pipes):
            loop.stop()

    for index, (read_end, write_end) in enumerate(pipes):
        kind = "node" if index % 2 else "listener"
        loop.add(read_end, partial(ready, read_end, kind), listener=kind == "listener")
        os.write(write_end, b"x")
    loop.run()
    assert seen == ["node"] * 3 + ["listener"] * 3
    for pipe in pipes:
        for fd in pipe:
            os.close(fd)


def test_what_was_removed_in_a_round_is_not_called_in_it(loop: Loop) -> None:
    one, other = socket.socketpair(), socket.socketpair()
    seen: list[int] = []

    def take(mine: int, theirs: int) -> None:
        seen.append(mine)
        loop.remove(theirs)
        loop.stop()

    first, second = one[0].fileno(), other[0].fileno()
    loop.add(first, lambda: take(first, second))
    loop.add(second, lambda: take(second, first))
    one[1].send(b"x")
    other[1].send(b"x")
    loop.run()
    assert len(seen) == 1
    for end in (*one, *other):
        end.close()


def test_what_is_removed_twice_or_was_closed_before_is_fine(loop: Loop, pair) -> None:
    ours, _ = pair
    number = ours.fileno()
    loop.add(number, loop.stop)
    ours.close()
    loop.remove(number)
    loop.remove(number)


def test_a_writer_is_called_instead_of_the_reader_until_it_is_taken_back(loop: Loop, pair) -> None:
    ours, theirs = pair
    seen: list[str] = []
    number = ours.fileno()

    def writable() -> None:
        seen.append("write")
        loop.watch_write(number, None)

    loop.add(number, lambda: (seen.append("read"), loop.stop()))
    loop.watch_write(number, writable)
    theirs.send(b"x")
    loop.run()
    assert seen == ["write", "read"]


def test_a_paused_descriptor_waits_until_it_is_resumed(loop: Loop, pair) -> None:
    ours, theirs = pair
    seen: list[str] = []
    loop.add(ours.fileno(), lambda: (seen.append("read"), loop.stop()))
    loop.pause(ours.fileno())
    theirs.send(b"x")
    loop.call_later(0.01, lambda: (seen.append("resumed"), loop.resume(ours.fileno())))
    loop.run()
    assert seen == ["resumed", "read"]


def test_the_end_of_a_peer_is_seen_while_the_descriptor_is_paused(loop: Loop, pair) -> None:
    ours, theirs = pair
    loop.add(ours.fileno(), loop.stop)
    loop.pause(ours.fileno())
    theirs.close()
    loop.run()


def test_a_call_from_another_thread_returns_its_result_or_raises_its_error(loop: Loop, beside) -> None:
    thread = beside()
    assert loop.ask(threading.get_ident, WAIT) == thread.ident
    with pytest.raises(ZeroDivisionError):
        loop.ask(lambda: 1 // 0, WAIT)
    assert loop.ask(lambda: loop.ask(threading.get_ident), WAIT) == thread.ident


def test_before_the_loop_runs_the_calling_thread_makes_the_call(loop: Loop) -> None:
    assert loop.ask(threading.get_ident) == threading.get_ident()


def test_a_loop_that_is_busy_is_not_waited_for_longer_than_asked(loop: Loop, beside) -> None:
    free = threading.Event()
    beside()
    loop.call_threadsafe(lambda: free.wait(WAIT))
    with pytest.raises(TimeoutError, match="0 s"):
        loop.ask(lambda: None, 0.01)
    free.set()


def test_a_call_from_another_thread_wakes_an_idle_loop(loop: Loop, beside) -> None:
    beside()
    called = threading.Event()
    loop.call_threadsafe(called.set)
    assert called.wait(WAIT)


def test_what_was_asked_for_before_the_stop_is_still_done(loop: Loop) -> None:
    seen: list[str] = []
    loop.call_soon(lambda: (loop.stop(), loop.call_threadsafe(lambda: seen.append("done"))))
    loop.run()
    assert seen == ["done"]


def test_a_loop_that_was_stopped_before_it_ran_does_not_wait(loop: Loop) -> None:
    loop.stop()
    loop.run()


@pytest.mark.parametrize("how", ["call_soon", "call_threadsafe"])
def test_the_simulators_loop_ends_with_the_first_error(how: str) -> None:
    loop = Loop()
    getattr(loop, how)(lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        loop.run()
    loop.close()


def test_the_daemons_loop_logs_errors_and_goes_on(pair, caplog: pytest.LogCaptureFixture) -> None:
    ours, theirs = pair
    loop = DaemonLoop()

    def read() -> None:
        ours.recv(1)
        loop.call_later(0.0, loop.stop)
        raise OSError("of a descriptor")

    loop.add(ours.fileno(), read)
    loop.call_later(0.0, lambda: 1 // 0)
    loop.call_soon(lambda: {}["none"])
    theirs.send(b"x")
    with caplog.at_level(logging.ERROR):
        loop.run()
    loop.close()
    kinds = [record.exc_info[0] for record in caplog.records if record.exc_info]
    assert caplog.messages == ["a callback failed"] * 3
    assert sorted(kind.__name__ for kind in kinds if kind) == ["KeyError", "OSError", "ZeroDivisionError"]


@pytest.mark.parametrize(("works", "waits"), [(0.0, 10), (0.0065, 4), (0.25, 0)])
def test_what_a_timers_call_takes_is_not_waited_for_again(
    works: float, waits: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a clock of its own, which only a call moves: the next timer is due 10 ms after the first."""
    clock = [0.0]
    waited: list[int] = []

    class Recorded(Loop):
        def _wait(self, milliseconds: int) -> None:
            waited.append(milliseconds)
            self.stop()

    def work() -> None:
        clock[0] += works

    monkeypatch.setattr("cm.loop.time.monotonic", lambda: clock[0])
    loop = Recorded()
    loop.call_later(0.0, work)
    loop.call_later(0.010, lambda: None)
    loop.run()
    loop.close()
    assert waited == [waits]
