# SPDX-License-Identifier: Apache-2.0
"""``cm sim``: serve a simulated board; ``cm sim inject|state|…``: control a running one."""

from __future__ import annotations

import argparse
import logging
import os
from pathlib import Path
from typing import TYPE_CHECKING

from cm.cli.common import add_json_option, answer, completes, natural, number, parsed, positive, print_json
from cm.cli.parser import RawHelp
from cm.errors import NotFound

if TYPE_CHECKING:
    from cm.simulation.software import Control

_FAULTS = """faults (TARGET, VALUE):
  short_packet     channel, bytes      the next packet ends early
  dma_error        channel             the next transfer fails with EIO
  hang             channel             nothing moves until cleared
  drop_interrupt   interrupt           the next one does not come
  icap_crc, icap_id, icap_hang         how the next load fails
  icap_stall       '', bytes           the port takes no more until cleared
  icap_write_only                      the port cannot be read until cleared
  overlay_error    overlay             the next one cannot be applied
  probe_error      node                no driver takes the device it makes
  fpga_manager_error                   the next load fails at its end
  register_stuck   register            writes are lost until cleared
  clock_stuck      clock               its rate stays until cleared
  gpio_stuck       LABEL:LINE          the line keeps its value until cleared
"""


_UPSET = "Turn over bits of the configuration memory under a region that runs; says frame, word and bit of each."


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    from cm.simulation.software.process.arguments import add_arguments

    parser.description = "Serve a simulated board in a folder until it is interrupted."
    parser.epilog = _FAULTS
    parser.formatter_class = RawHelp
    add_arguments(parser)
    parser.add_argument("--rtl", type=Path, metavar="FOLDER",
        help="run the HDL of the build schema there, as `cm serve --sim=rtl --build FOLDER` does")  # fmt: skip
    parser.set_defaults(run=run, refuse=parser.error)
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=False)
    _add_actions(actions)


def run(args: argparse.Namespace) -> int:
    """Serve, or carry out one action on a simulator that runs; the exit status."""
    if getattr(args, "action", None) is None:
        logging.basicConfig(level=logging.WARNING, format="cm sim: %(message)s")
        if args.rtl is not None:
            from cm.simulation.rtl.main import run as serve_rtl

            args.build, args.traces = args.rtl, False
            return serve_rtl(args)
        from cm.simulation.software.process.main import run as serve

        return serve(args)
    return _act(args)


def _add_actions(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    inject = actions.add_parser("inject", help="inject a fault")
    completes(inject.add_argument("name", metavar="FAULT"), "<fault>")
    completes(inject.add_argument("target", nargs="?"), "<target>")
    inject.add_argument("value", nargs="?", type=natural, default=0)
    inject.add_argument("--count", type=natural, default=1, help="how many times (default: 1); 0: until cleared")
    clear = actions.add_parser("clear", help="remove injected faults")
    completes(clear.add_argument("name", nargs="?", metavar="FAULT"), "<fault>")
    completes(clear.add_argument("target", nargs="?"), "<target>")
    interrupt = actions.add_parser("interrupt", help="raise an interrupt")
    completes(interrupt.add_argument("name"), "<interrupt>")
    upset = actions.add_parser(
        "upset", help="turn over bits of a region's configuration, as radiation does", description=_UPSET
    )
    completes(upset.add_argument("--region", required=True, metavar="NAME"), "<region>")
    upset.add_argument("--bits", type=positive, default=1, help="how many, each in a random place (default: 1)")
    address = parsed("an address such as 0x00400080", number)
    upset.add_argument("--frame", type=address, metavar="FAR", help="in this frame, by its address (0x00400080)")
    upset.add_argument("--bit", type=natural, metavar="N", help="with --frame: this bit, 32 times the word and its bit")
    trace = actions.add_parser("trace", help="record the signals of the RTL in FST files")
    trace.add_argument("what", choices=("start", "stop"))
    trace.add_argument("folder", nargs="?", type=Path, metavar="DIR", help="where the files go")
    actions.add_parser("state", help="print what the board holds, as JSON")
    for parser in actions.choices.values():
        parser.add_argument(
            "--root",
            type=Path,
            default=argparse.SUPPRESS,
            metavar="DIR",
            help="folder that the simulator serves (default: $CM_ROOT, or that of this machine's `cm serve --sim`)",
        )
        parser.set_defaults(run=run, refuse=parser.error)
    add_json_option(upset, run)


def _act(args: argparse.Namespace) -> int:
    from cm.simulation.software import Control

    _carry_out(Control(args.root or _served()), args)
    return 0


def _served() -> Path:
    """The board that $CM_ROOT names, else that of the manager that commands find. Raises NotFound."""
    named = os.environ.get("CM_ROOT")
    if named:
        return Path(named)
    from cm.client.find_manager import default_runtime_dir
    from cm.simulation.software.transport.protocol import CONTROL_PATH

    folder = default_runtime_dir() / "board"
    if not (folder / CONTROL_PATH).exists():
        raise NotFound(f"no simulated board in {folder}: is `cm serve --sim` running? --root names another folder")
    return folder


def _carry_out(control: Control, args: argparse.Namespace) -> None:
    if args.action == "inject":
        control.inject(args.name, args.target, args.count, args.value)
    elif args.action == "clear":
        control.clear(args.name, args.target)
    elif args.action == "interrupt":
        control.interrupt(args.name)
    elif args.action == "upset":
        _upset(control, args)
    elif args.action == "trace":
        _trace(control, args)
    else:
        print_json(control.state())


def _upset(control: Control, args: argparse.Namespace) -> None:
    if args.bit is not None and args.frame is None:
        args.refuse("upset --bit N: in which frame? add --frame FAR")
    hits = control.upset(args.region, args.bits, args.frame, args.bit)
    told = [{"frame": f"0x{far:08x}", "word": bit // 32, "bit": bit % 32} for far, bit in hits]
    lines = [f"{args.region}: frame {hit['frame']}, word {hit['word']}, bit {hit['bit']}" for hit in told]
    answer(args, told, "\n".join(lines))


def _trace(control: Control, args: argparse.Namespace) -> None:
    if args.what == "start" and args.folder is None:
        args.refuse("trace start DIR: the folder that the files go to")
    if args.what == "start":
        args.folder.mkdir(parents=True, exist_ok=True)
    control.trace(args.folder if args.what == "start" else None)
