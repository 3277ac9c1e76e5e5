# SPDX-License-Identifier: Apache-2.0
"""``cm serve``: run the configuration manager."""

from __future__ import annotations

import argparse
import gc
import logging
import os
import signal
import sys
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from cm.cli.common import natural, parsed
from cm.cli.serve_settings import (
    access_of,
    configs_of,
    default_runtime_dir,
    default_state_dir,
    group_of,
    read_again,
    secure_as,
    security_of,
    settings_of,
    stamps,
)
from cm.errors import InvalidRequest
from cm.server.settings.model import FILE as SETTINGS_FILE
from cm.server.settings.model import Settings as Defaults
from cm.wire.topics import ipc_endpoints

_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6), (0, 7))
_SWITCH = 0.0005  # seconds, a tenth of Python's own
_SILENCE = 3.0  # seconds of a start without a word
_HDL = ("rtl", "bits")  # kinds of simulated board that run a design's HDL

if TYPE_CHECKING:
    from concurrent.futures import Future

    from cm.device import Root
    from cm.server.options import Options
    from cm.server.server import Server
    from cm.server.settings.model import Settings


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = (
        "Run the configuration manager until it is interrupted. With --sim it starts a "
        "simulated board of its own; without --config, it then loads the camera example "
        "in its default mode."
    )
    parser.add_argument(
        "--settings",
        type=Path,
        metavar="FILE",
        help=f"settings (default: {SETTINGS_FILE} if it exists); options override them",
    )
    parser.add_argument("--sim", nargs="?", const="models", default="", choices=("models", *_HDL), metavar="KIND",
        help="on a simulated board: models (software), rtl (a design's HDL), bits (of loaded bitstreams)")  # fmt: skip
    parser.add_argument("--sim-traces", action="store_true",
        help="with --sim=rtl: let 'cm sim trace' record signals (slower)")  # fmt: skip
    parser.add_argument("--build", type=Path, metavar="FILE",
        help="with --sim=rtl: build schema of the design (default: the shipped camera)")  # fmt: skip
    parser.add_argument(
        "--config", type=Path, action="append", default=[], metavar="DIR", help="schema file, or a folder of them"
    )
    parser.add_argument("--load", metavar="CONFIG[/MODE]", help="load this at start if nothing is loaded")
    parser.add_argument("--assume-loaded", action="store_true",
        help="take it that the PL holds its design since boot, though no fpga_manager says so")  # fmt: skip
    parser.add_argument("--name", metavar="NAME", help="the board's name, shown in its status (default: its host name)")
    parser.add_argument(
        "--runtime-dir", type=Path, metavar="DIR", help="folder of the sockets (default: $CM_RUNTIME_DIR, /run/cm)"
    )
    parser.add_argument("--state-dir", type=Path, metavar="DIR", help="folder of the state (default: /var/lib/cm)")
    parser.add_argument(
        "--root", metavar="DIR", help="folder that holds the board's /dev and /sys (default: $CM_ROOT, /)"
    )
    parser.add_argument(
        "--listen", action="append", default=[], metavar="tcp://HOST[:PORT]", help="also listen on TCP, on three ports"
    )
    parser.add_argument("--keys", type=Path, metavar="FILE", help="server key file of 'cm keygen', for TCP")
    parser.add_argument("--insecure", action="store_true", help="allow TCP beyond this machine without keys")
    parser.add_argument("--images", type=Path, metavar="DIR", help="with --sim: photographs for its camera")
    parser.add_argument("--models", action="append", default=[], metavar="FILE",
        help="with --sim: your own models, a .py file or module with a mapping MODELS")  # fmt: skip
    rate = parsed("a number, 0 or more", float, lambda value: 0 <= value < float("inf"))
    parser.add_argument(
        "--sim-icap-rate", type=rate, metavar="BYTES", help="with --sim: speed of its ICAP in bytes per second"
    )
    parser.add_argument(
        "--sim-hold", type=natural, metavar="FRAMES", help="with --sim: for how many frames each photograph stays"
    )
    parser.add_argument("-v", "--verbose", action="store_true", help="log more")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Serve; the exit status."""
    if args.sim == "bits" and not args.build:
        raise InvalidRequest("--sim=bits needs --build FILE, which the open flow has built")
    if (args.build or args.sim_traces) and args.sim not in _HDL:
        raise InvalidRequest("--build, --sim-traces: only with --sim=rtl (or bits)")
    settings = settings_of(args)
    _log_to(_level(args, settings), service=settings is not None)
    with ExitStack() as stack:
        stack.callback(signal.signal, signal.SIGTERM, signal.signal(signal.SIGTERM, _give_up))
        options = _options(args, settings, stack)
        from cm.server.server import Server

        server = Server(options)
        _obey_signals(server)
        where = [f"{options.runtime_dir}", *options.listen]
        server.serve(lambda: _ready(f"cm serve: ready at {', '.join(where)}"))
    return 0


def _ready(sentence: str) -> None:
    """What there is by now stays; and no thread waits for long while another, which works aside, has Python's lock."""
    gc.freeze()
    sys.setswitchinterval(_SWITCH)
    _say(sentence)


def _say(sentence: str) -> None:
    """Print to stderr; if that is a file on a full disk, we serve nevertheless."""
    with suppress(OSError):
        print(sentence, file=sys.stderr, flush=True)


def _level(args: argparse.Namespace, settings: Settings | None) -> int:
    if args.verbose:
        return logging.INFO
    return logging.WARNING if settings is None else int(getattr(logging, settings.log.upper()))


def _log_to(level: int, service: bool) -> None:
    """Log lines on stderr; where that is the journal's, each begins with its priority (sd-daemon(3))."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(Lines(_is_journal()))
    logging.basicConfig(level=level, handlers=[handler])
    if service:  # who did what belongs in a service's log at any level
        logging.getLogger("cm.audit").setLevel(logging.INFO)


def _is_journal() -> bool:
    """Whether our stderr is the journal's stream, as under systemd (systemd.exec(5))."""
    try:
        stderr = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{stderr.st_dev}:{stderr.st_ino}"


class Lines(logging.Formatter):
    """Records as lines that nothing from outside can forge: further lines are indented, control characters escaped."""

    def __init__(self, journal: bool) -> None:
        super().__init__("%(message)s" if journal else "cm serve: %(message)s")
        self._journal = journal

    def format(self, record: logging.LogRecord) -> str:
        """One record."""
        lines = super().format(record).splitlines() or [""]
        begin = f"<{next(number for level, number in _PRIORITIES if record.levelno >= level)}>" if self._journal else ""
        return begin + f"\n{begin}    ".join(
            "".join(c if c.isprintable() or c == "\t" else ascii(c)[1:-1] for c in x) for x in lines
        )


def _give_up(*_: object) -> None:
    """Told to end while it starts: what was started by then, as a simulated board, ends with it."""
    raise SystemExit(0)


def _obey_signals(server: Server) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: server.stop())
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # of nohup(1)
        action = server.stop if _has_terminal() else server.reload
        signal.signal(signal.SIGHUP, lambda *_: action())


def _has_terminal() -> bool:
    """Whether SIGHUP means that our terminal went away; a service has none, and reloads instead."""
    try:
        os.close(os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY | os.O_CLOEXEC))
    except OSError:
        return False
    return True


def _options(args: argparse.Namespace, settings: Settings | None, stack: ExitStack) -> Options:
    runtime = args.runtime_dir or (settings and settings.runtime_dir) or default_runtime_dir()
    ipc_endpoints(runtime)  # too long for a socket: refused before anything is made in it
    paths = args.config or (_simulated_schemas(args, runtime) if args.sim else [])
    board = _simulated_root(args, runtime, paths, stack) if args.sim else None
    # While the simulator starts, in a process of its own, this one gets on with its imports, also of what comes later.
    import cm.server.server  # noqa: F401
    from cm.device import Root
    from cm.manager.manager import Settings as ManagerSettings
    from cm.server.options import Options
    from cm.server.settings.model import Limits

    if args.sim == "rtl" and not args.build and Path("build.yaml").is_file():
        _say("cm serve: --sim=rtl runs the shipped camera; for the design of this folder: --build build.yaml")
    configs, left_out = configs_of(paths, settings)
    if not configs and sys.stderr.isatty():
        _say("cm serve: no configuration was found: --config DIR names some, --sim brings a simulated board with one")
    for sentence in left_out:
        logging.getLogger("cm").error("left out: %s", sentence)
    root = Root.of(args.root) if board is None else _started(board, args.sim)
    listen, keys, insecure = secure_as(args, settings)
    access, notes = access_of(settings, keys)
    for sentence in notes:
        logging.getLogger("cm").warning("%s", sentence)
    example = args.sim and not args.config and not args.build
    said = settings or Defaults()
    return Options(
        runtime_dir=runtime,
        state_dir=args.state_dir or said.state_dir or default_state_dir(runtime, bool(args.sim)),
        root=root,
        configs=configs,
        listen=tuple(listen),
        security=security_of(listen, keys, insecure),
        access=access,
        group=group_of(settings),
        name=args.name or said.name,
        load=args.load or said.load or ("camera" if example else ""),
        settings=ManagerSettings(prefetch_bytes=said.dma.prefetch_mib << 20, new_board=board is not None),
        scrub=said.scrub,
        queue_bytes=int(said.streams.queue_mib * (1 << 20)),
        assume_loaded=args.assume_loaded or said.assume_loaded,
        limits=Limits.of(said.limits),
        example=example,
        unsigned=said.policy.signatures != "require",
        reload=partial(read_again, args, paths, settings),
        changed=partial(stamps, args, settings),
    )


def _simulated_schemas(args: argparse.Namespace, runtime: Path) -> list[Path]:
    data = Path(__file__).parents[1] / "data"  # importlib.resources is 1.3 MiB
    if args.build:
        from cm.cli.simulated_board import schema_of_build

        return [schema_of_build(args.build, runtime, args.sim)]
    return [data / ("examples/camera/config" if args.sim == "rtl" else "camera")]


def _started(board: Future[Root], kind: str) -> Root:
    """The board, when it is there; says so where that takes long."""
    from concurrent.futures import wait

    if kind in _HDL and not wait([board], _SILENCE).done:
        _say("cm serve: the design is being prepared; the first time its HDL is compiled, which takes a minute or more")
    return board.result()


def _absolute(source: str) -> str:
    """The simulator is a process of its own, in a folder of its own; a module has no path."""
    return str(Path(source).absolute()) if source.endswith(".py") else source


def _simulated_root(args: argparse.Namespace, runtime: Path, paths: list[Path], stack: ExitStack) -> Future[Root]:
    from concurrent.futures import ThreadPoolExecutor

    from cm.cli.simulated_board import simulated_board

    arguments = ["--images", str(args.images)] if args.images else []
    arguments += [part for source in args.models for part in ("--models", _absolute(source))]
    arguments += ["--hold", str(args.sim_hold)] if args.sim_hold is not None else []
    arguments += ["--icap-rate", str(args.sim_icap_rate)] if args.sim_icap_rate is not None else []
    arguments += ["--build", str(args.build.resolve())] if args.build else []
    arguments += ["--traces"] if args.sim_traces else []
    root = Path(args.root) if args.root else runtime / "board"
    starter = stack.enter_context(ThreadPoolExecutor(1, "cm-board"))
    program = f"cm.simulation.{args.sim}" if args.sim in _HDL else "cm.simulation.software"
    return starter.submit(stack.enter_context, simulated_board(runtime, root, paths, arguments, program))
