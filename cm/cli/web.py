# SPDX-License-Identifier: Apache-2.0
"""``cm web``: a page that shows a board in a browser."""

from __future__ import annotations

import argparse
import os
import ssl
import stat
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from cm.cli.common import add_connection_options, run_until_told
from cm.cli.fleet_options import add_network_options
from cm.errors import CmError, InvalidRequest, NotFound
from cm.extras import installing

if TYPE_CHECKING:
    from collections.abc import Callable

    from cm.networks.fleet.aio import Fleet
    from cm.web.server import Options

PORT = 8470


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = (
        "Serve a page that shows the board's streams, modes, registers, interrupts and "
        "errors, and print its address. Anyone who has that address can see the page and,"
        " with --control, change modes and registers. The page is a client of the manager"
        " like any other, with the rights of this user or those of --keys."
    )
    add_connection_options(parser)
    parser.add_argument(
        "--listen",
        default="",
        metavar="HOST[:PORT]",
        help=f"address to serve on (default: 127.0.0.1:{PORT}; port 0: a free one)",
    )
    parser.add_argument("--record", type=Path, metavar="FILE", help="show a record of `cm record`, with a time slider")
    parser.add_argument("--control", action="store_true", help="let the page change modes and write registers")
    parser.add_argument(
        "--token-file", type=Path, metavar="FILE", help="file with the token of the address (default: a new token)"
    )
    parser.add_argument("--name", action="append", default=[], help="a name under which browsers reach this machine")
    parser.add_argument("--tls", nargs=2, type=Path, metavar=("CERT", "KEY"), help="serve over TLS: PEM files")
    parser.add_argument("--insecure", action="store_true", help="allow other machines without TLS")
    parser.add_argument("--fleet", action="store_true", help="also show the boards of a fleet (docs/fleet.md)")
    add_network_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted; the exit status."""
    if args.record is not None and (args.control or args.fleet):
        raise InvalidRequest("--record FILE shows what was: it goes without --control and --fleet")
    options = _options(args)
    if args.record is None:
        _note_absence(args, options)
    from cm.web.server import PageServer

    return run_until_told(lambda: PageServer(options).serve(_say))


def _note_absence(args: argparse.Namespace, options: Options) -> None:
    """Say that no manager is there yet, where that shows at once; the page waits for it."""
    from cm.client.find_manager import find

    with suppress(CmError, OSError):  # what else is wrong, the page says
        try:
            find(args.connect, args.runtime_dir, args.keys)
        except NotFound as error:
            if options.fleet is None:
                _say(f"{error}; the page waits for it")


def _say(words: str) -> None:
    print(f"cm web: {words}", file=sys.stderr, flush=True)


def _options(args: argparse.Namespace) -> Options:
    import cm.client.aio as aio

    try:
        from cm.web.gate import Gate, is_loopback
        from cm.web.server import Options
    except ModuleNotFoundError as error:
        if error.name != "aiohttp":
            raise
        raise InvalidRequest(f"cm web needs aiohttp and Pillow: {installing('web')}") from None
    host, port = _address(args.listen)
    tls = _tls(*args.tls) if args.tls else None
    if tls is None and not args.insecure and not is_loopback(host):
        raise InvalidRequest(
            f"{host}: the token and all that is seen would cross the network as plain text; "
            "give --tls CERT KEY, or say --insecure"
        )
    gate = Gate.of(_token(args.token_file), [*args.name, host])
    return Options(
        lambda: aio.connect(args.connect, runtime_dir=args.runtime_dir, keys=args.keys),
        gate, host, port, args.control, tls, _fleet(args), args.record,
    )  # fmt: skip


def _fleet(args: argparse.Namespace) -> Callable[[], Fleet] | None:
    """How to reach the fleet, where one is given; None for one board alone."""
    if not (args.fleet or args.router or args.zenoh_config or args.store):
        return None
    from cm.networks.fleet import aio as fleet
    from cm.networks.fleet.zenoh_session import endpoint, zenoh_module

    zenoh_module()  # said at once where it is missing
    routers = tuple(map(endpoint, args.router))
    return lambda: fleet.connect(routers, config=args.zenoh_config, store=args.store)


def _address(text: str) -> tuple[str, int]:
    """Raises InvalidRequest."""
    host, port = text, ""
    if text.isdecimal():
        host, port = "", text
    elif ":" in text and not text.endswith("]"):
        host, _, port = text.rpartition(":")
    if port and not (port.isascii() and port.isdecimal() and int(port) <= 65535):
        raise InvalidRequest(f"--listen {text}: HOST, HOST:PORT or PORT is wanted, such as 127.0.0.1:{PORT}")
    return host.strip("[]") or "127.0.0.1", int(port) if port else PORT


def _token(path: Path | None) -> str:
    if path is None:
        return ""
    try:
        with path.open(encoding="ascii") as file:
            token, mode = file.read().strip(), os.fstat(file.fileno()).st_mode
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidRequest(f"--token-file {path}: {error}") from error
    if not token:
        raise InvalidRequest(f"--token-file {path}: it is empty")
    if stat.S_ISREG(mode) and mode & 0o007:
        raise InvalidRequest(f"--token-file {path}: all users of this machine may read it: chmod 600 {path}")
    return token


def _tls(certificate: Path, key: Path) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_cert_chain(certificate, key)
    except (OSError, ssl.SSLError) as error:
        raise InvalidRequest(f"--tls {certificate} {key}: {error}") from error
    return context
