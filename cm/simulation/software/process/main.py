# SPDX-License-Identifier: Apache-2.0
"""The simulator's process: arguments, signals, who owns it, its end."""

from __future__ import annotations

import argparse
import contextlib
import errno
import json
import logging
import os
import select
import signal
import socket
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from cm.errors import CmError, sentence
from cm.loop import Loop
from cm.schema.model import Config
from cm.simulation.software.errors import NodeError, SimError
from cm.simulation.software.hardware.board_spec import BoardSpec
from cm.simulation.software.hardware.camera import load_photos
from cm.simulation.software.hardware.logic import MakeLogic, Options, SoftwareLogic
from cm.simulation.software.hardware.models import Models
from cm.simulation.software.process.arguments import add_arguments
from cm.simulation.software.process.machine import Machine
from cm.simulation.software.process.orders import Orders
from cm.simulation.software.transport.root import Root

_CHECK = 0.25


class Parent:
    """The process that the simulator was started by, or taken over by later."""

    def __init__(self) -> None:
        self._pid = os.getppid()
        self._fd = _pidfd(self._pid)

    @property
    def dead(self) -> bool:
        """Whether it has ended, also if it did before we looked."""
        return self._fd < 0 or bool(select.select([self._fd], [], [], 0)[0])

    def replace(self, pid: int) -> None:
        """Belong to another process from now on (EBUSY while the present owner lives, ESRCH)."""
        if not self.dead:
            raise NodeError(errno.EBUSY, f"process {self._pid} owns this simulator")
        fd = _pidfd(pid)
        if fd < 0:
            raise NodeError(errno.ESRCH, f"there is no process {pid}")
        if self._fd >= 0:
            os.close(self._fd)
        self._pid, self._fd = pid, fd


class Linger:
    """Stops the loop when the parent is dead and no client was connected for a while."""

    def __init__(self, loop: Loop, connections: Callable[[], int], parent: Parent, seconds: float) -> None:
        self._loop, self._connections, self._parent = loop, connections, parent
        self._left = self._seconds = seconds

    def check(self) -> None:
        """Look now, and again."""
        idle = self._parent.dead and not self._connections()
        self._left = self._left - _CHECK if idle else self._seconds
        if self._left < 0:
            self._loop.stop()
        else:
            self._loop.call_later(_CHECK, self.check)


def _pidfd(pid: int) -> int:
    try:
        return os.pidfd_open(pid)
    except OSError:
        return -1


def main(argv: Sequence[str] | None = None) -> int:
    """``python -m cm.simulation.software``; the exit status."""
    parser = argparse.ArgumentParser("python -m cm.simulation.software", description="a simulated board under a folder")
    add_arguments(parser)
    logging.basicConfig(level=logging.WARNING, format="cm sim: %(message)s")
    return run(parser.parse_args(argv))


def run(args: argparse.Namespace, make: MakeLogic = SoftwareLogic) -> int:
    """Serve until a signal or the linger time ends it; `make` makes the logic behind the nodes."""
    parent = Parent() if args.linger is not None else None
    _models_print_to_stderr(args)
    try:
        configs, models = _configs(args.config), _models(args.models)
        if make is SoftwareLogic:  # other logic has no use for models, whatever the schemas call theirs
            models.check(configs)
        spec, options = BoardSpec.from_configs(configs), _options(args)
        if args.static_identity is not None:
            spec = spec.with_static(args.static_identity)
        root = Root(args.root)
    except (CmError, OSError) as error:
        return failed(sentence(error), args)
    try:
        _serve(args, partial(Machine, root=root, spec=spec, models=models, options=options, make=make), parent)
    except (CmError, OSError) as error:
        print(f"cm sim: {sentence(error)}", file=sys.stderr)
        return 1
    finally:
        root.close()
    return 0


def failed(why: object, args: argparse.Namespace) -> int:
    """Say why nothing will be served: to the `Board` that started us, which says it once, or on stderr; the status."""
    if args.linger is None:
        print(f"cm sim: {why}", file=sys.stderr)
    else:
        os.write(
            1 if args.ready_fd is None else args.ready_fd,
            f"{json.dumps({'ready': False, 'error': str(why)})}\n".encode(),
        )
    return 1


def _models_print_to_stderr(args: argparse.Namespace) -> None:
    """What a model prints is for people; who started us reads one line of standard output, and no more."""
    if args.linger is not None and args.ready_fd is None:
        args.ready_fd = os.dup(1)
        os.dup2(2, 1)
        sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]


def _serve(args: argparse.Namespace, made: Callable[[Loop], Machine], parent: Parent | None) -> None:
    loop = Loop()
    with contextlib.ExitStack() as stack:
        stack.callback(loop.close)
        stack.enter_context(_Signals(loop))
        machine = made(loop)
        stack.callback(machine.close)
        machine.serve()
        Orders(machine, parent.replace if parent is not None else None)
        if parent is not None:
            Linger(loop, lambda: machine.server.connections, parent, args.linger).check()
        _say_ready(args.ready_fd, machine.root)
        loop.run()


def _say_ready(fd: int | None, root: Root) -> None:
    line = json.dumps({"ready": True, "root": str(root.path), "pid": os.getpid()}) + "\n"
    with contextlib.suppress(BrokenPipeError):
        if fd is None:
            sys.stdout.write(line)
            sys.stdout.flush()
        else:
            os.write(fd, line.encode())
            os.close(fd)


def _options(args: argparse.Namespace) -> Options:
    return Options(
        photos=list(load_photos(args.images).values()) if args.images else None,
        hold=max(0, args.hold),
        rate=args.rate,
        icap_rate=args.icap_rate,
        pcap_rate=args.pcap_rate,
        memory=args.memory << 20,
        vdma=frozenset(args.vdma),
        simple=dict(args.simple_dma),
        coherent=not args.non_coherent,
    )


def _models(sources: Sequence[str]) -> Models:
    models = Models.standard()
    models.load_entry_points()
    for source in sources:
        models.load(source)
    return models


def _configs(paths: Sequence[Path]) -> list[Config]:
    from cm.schema import load, load_folder

    configs: list[Config] = []
    for path in paths or [example_folder()]:
        configs += load_folder(path).values() if path.is_dir() else [load(path)]
    if not configs:
        raise SimError(f"no runtime schema was found in {', '.join(map(str, paths))}")
    return configs


def example_folder() -> Path:
    """The camera example that comes with the package."""
    return Path(__file__).resolve().parents[3] / "data" / "camera"


class _Signals:
    """SIGTERM and SIGINT end the loop, through a wake-up socket."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._ours, self._theirs = socket.socketpair()

    def __enter__(self) -> None:
        self._ours.setblocking(False)
        self._theirs.setblocking(False)
        self._loop.add(self._ours.fileno(), self._loop.stop)
        signal.set_wakeup_fd(self._theirs.fileno(), warn_on_full_buffer=False)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: self._loop.stop())

    def __exit__(self, *_: object) -> None:
        signal.set_wakeup_fd(-1)
        self._ours.close()
        self._theirs.close()
