# SPDX-License-Identifier: Apache-2.0
"""``cm serve``: run the configuration manager."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from cm.errors import CmError, InvalidRequest

if TYPE_CHECKING:
    from concurrent.futures import Future

    from cm.daemon.endpoints import Security
    from cm.daemon.server import Options, Server
    from cm.device import Root
    from cm.schema.model import Config


class InsecureListen(CmError):
    """Listening for everybody without keys was not asked for in so many words."""

    code = "insecure_listen"


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "serve",
        help="run the configuration manager",
        description="Run the configuration manager until it is interrupted. With --sim it brings a simulated board "
        "of its own, and without --config the camera example, loaded in its default mode.",
    )
    parser.add_argument("--sim", action="store_true", help="on a simulated board (no hardware, no root)")
    parser.add_argument(
        "--config", type=Path, action="append", default=[], metavar="DIR", help="schema file, or a folder of them"
    )
    parser.add_argument("--load", metavar="CONFIG[/MODE]", help="enter this where nothing is loaded at start")
    parser.add_argument("--runtime-dir", type=Path, metavar="DIR", help="folder of the sockets (default: /run/cm)")
    parser.add_argument("--state-dir", type=Path, metavar="DIR", help="folder of the state (default: /var/lib/cm)")
    parser.add_argument("--root", metavar="DIR", help="where the board's /dev and /sys begin (default: $CM_ROOT, /)")
    parser.add_argument(
        "--listen", action="append", default=[], metavar="tcp://HOST[:PORT]", help="listen on TCP too: three ports"
    )
    parser.add_argument("--keys", type=Path, metavar="FILE", help="server key file of 'cm keygen', for TCP")
    parser.add_argument("--insecure", action="store_true", help="allow TCP beyond this machine without keys")
    parser.add_argument("--prefetch", type=int, default=64, metavar="MIB", help="DMA memory for images held ready")
    parser.add_argument("--stream-queue", type=_mebibytes, default=32 << 20, metavar="MIB",
        help="frames that may wait for each subscriber over ZeroMQ, by the schemas' longest (default: 32)")  # fmt: skip
    parser.add_argument("--images", type=Path, metavar="DIR", help="with --sim: photographs for its camera")
    parser.add_argument("--sim-icap-rate", type=float, metavar="BYTES", help="with --sim: bytes per second of its ICAP")
    parser.add_argument("--sim-hold", type=int, metavar="FRAMES", help="with --sim: frames that a photograph stays")
    parser.add_argument("-v", "--verbose", action="store_true", help="log what goes on")
    parser.set_defaults(run=run)


def _mebibytes(text: str) -> int:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 1 << 20:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of MiB from 0 to 1048576")
    return int(value * (1 << 20))


def run(args: argparse.Namespace) -> int:
    """Serve; the exit status."""
    logging.basicConfig(
        level=logging.INFO if args.verbose else logging.WARNING, format="cm serve: %(message)s", stream=sys.stderr
    )
    with ExitStack() as stack:
        options = _options(args, stack)
        from cm.daemon.server import Server

        server = Server(options)
        _stop_on_signals(server)
        where = [f"{options.runtime_dir}", *options.listen]
        server.serve(lambda: print(f"cm serve: ready at {', '.join(where)}", file=sys.stderr, flush=True))
    return 0


def _stop_on_signals(server: Server) -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: server.stop())


def _options(args: argparse.Namespace, stack: ExitStack) -> Options:
    from cm.client.address import default_runtime_dir

    runtime = args.runtime_dir or default_runtime_dir()
    paths = args.config or ([_camera()] if args.sim else [])
    board = _simulated_root(args, runtime, paths, stack) if args.sim else None
    # While the simulator starts, in a process of its own, this one gets on with its imports.
    from cm.daemon.server import Options
    from cm.device import Root
    from cm.manager.manager import Settings

    configs = _load_configs(paths)
    root = Root.of(args.root) if board is None else board.result()
    example = args.sim and not args.config
    return Options(
        runtime_dir=runtime,
        state_dir=args.state_dir or _default_state_dir(runtime, args.sim),
        root=root,
        configs=configs,
        listen=tuple(args.listen),
        security=_security(args),
        load=args.load or ("camera" if example else ""),
        settings=Settings(prefetch_bytes=args.prefetch << 20),
        queue_bytes=args.stream_queue,
    )


def _camera() -> Path:
    return Path(__file__).parents[1] / "data/camera"  # importlib.resources is 1.3 MiB


def _load_configs(paths: list[Path]) -> dict[str, Config]:
    from cm.schema import load, load_folder

    found: dict[str, Config] = {}
    for path in paths:
        new = load_folder(path) if path.is_dir() else {c.name: c for c in [load(path)]}
        twice = found.keys() & new.keys()
        if twice:
            raise InvalidRequest(f"configuration {min(twice)!r} comes twice, the second time from {path}")
        found.update(new)
    return found


def _simulated_root(args: argparse.Namespace, runtime: Path, paths: list[Path], stack: ExitStack) -> Future[Root]:
    from concurrent.futures import ThreadPoolExecutor

    from cm.cli.simboard import simulated_board

    arguments = ["--images", str(args.images)] if args.images else []
    arguments += ["--hold", str(args.sim_hold)] if args.sim_hold is not None else []
    arguments += ["--icap-rate", str(args.sim_icap_rate)] if args.sim_icap_rate is not None else []
    root = Path(args.root) if args.root else runtime / "board"
    starter = stack.enter_context(ThreadPoolExecutor(1, "cm-board"))
    return starter.submit(stack.enter_context, simulated_board(runtime, root, paths, arguments))


def _default_state_dir(runtime: Path, sim: bool) -> Path:
    if sim:
        return runtime / "state"
    if os.geteuid() == 0:
        return Path("/var/lib/cm")
    home = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(home) / "cm"


def _security(args: argparse.Namespace) -> Security | None:
    if args.keys:
        from cm.cli.keys import load_server_keys

        return load_server_keys(args.keys)
    for address in args.listen:
        host = address.removeprefix("tcp://").rpartition(":")[0] or address
        if not args.insecure and host not in ("127.0.0.1", "localhost", "[::1]"):
            raise InsecureListen(
                f"{address}: anybody who reaches it could change the hardware; "
                "make keys ('cm keygen') and give --keys, or say --insecure"
            )
    return None
