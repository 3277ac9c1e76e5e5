# SPDX-License-Identifier: Apache-2.0
"""``cm demo``: the camera demonstration on a simulated board."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from cm.errors import InvalidRequest
from cm.extras import installing


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = (
        "Stream photographs through a reconfigurable region, change its module and "
        "registers meanwhile, and write the results as a contact sheet. Needs neither "
        "hardware nor root."
    )
    parser.add_argument("--images", type=Path, metavar="DIR", help="PNG or JPEG files instead of the shipped ones")
    parser.add_argument("--out", type=Path, default=Path("demo"), metavar="DIR", help="folder to write to (demo)")
    parser.add_argument("--keep-frames", action="store_true", help="also write the raw frames (frames.npz)")
    parser.add_argument("--rtl", action="store_true", help="run the modules' Verilog instead of models in software")
    parser.add_argument(
        "--fleet", action="store_true", help="instead, run three boards over zenoh, one of which is killed"
    )
    parser.add_argument(
        "--store", choices=("keeper", "etcd"), default="keeper", help="with --fleet: where the wanted state is (keeper)"
    )
    parser.add_argument("--scrub", type=Path, metavar="FILE",
        help="a bit of the configuration turns over, and is put right: schema of the example open_camera")  # fmt: skip
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run it; the exit status."""
    try:
        from PIL import Image  # noqa: F401 (asked for before anything is started)
    except ModuleNotFoundError:
        raise InvalidRequest(f"the demo writes a picture with Pillow: {installing('demo')}") from None
    started = time.monotonic()
    print(f"wrote     {_shown(args)} after {time.monotonic() - started:.1f} s")
    return 0


def _shown(args: argparse.Namespace) -> Path:
    """The picture that the chosen demonstration has made."""
    if args.fleet:
        from cm.tools.demo.fleet import run_fleet_demo

        return run_fleet_demo(args.out, args.store)
    if args.scrub:
        from cm.tools.demo.scrub import run_scrub_demo

        return run_scrub_demo(args.scrub, args.out)
    from cm.tools.demo.runner import run_demo

    return run_demo(args.images, args.out, args.keep_frames, "rtl" if args.rtl else "models")
