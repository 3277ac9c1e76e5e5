# SPDX-License-Identifier: Apache-2.0
"""``cm bridge fleet``: a board in a fleet."""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from cm.cli.common import add_connection_options, parsed, run_until_told
from cm.cli.fleet_options import add_network_options, network_of
from cm.errors import InvalidRequest

if TYPE_CHECKING:
    from cm.networks.fleet.bridge.bridge_process import Options
    from cm.networks.fleet.bridge.bundles import Import


def add_fleet_parser(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the network."""
    parser = actions.add_parser(
        "fleet",
        help="make a board a member of a fleet, over zenoh",
        description="Run beside a board's manager until stopped, and make the board a member of a "
        "fleet (docs/fleet.md). The manager's policy decides what callers may do: "
        "access.guests in cm.yaml.",
    )
    add_connection_options(parser)
    add_network_options(parser)
    parser.add_argument(
        "--listen", action="append", default=[], metavar="HOST:PORT", help="accept connections of others here"
    )
    parser.add_argument(
        "--name",
        default="",
        help="the board's name in the fleet (default: that in its certificate, or else the one that its manager gives)",
    )
    parser.add_argument(
        "--label", action="append", default=[], metavar="TEXT", help="a group that the board belongs to"
    )
    parser.add_argument(
        "--join", action="store_true", help="put the board into the inventory, as one with a certificate does by itself"
    )
    parser.add_argument(
        "--keeper", action="store_true", help="keep the fleet's wanted state here; on one board, and without etcd"
    )
    parser.add_argument(
        "--state-dir", type=Path, metavar="DIR", help="folder for what it has to remember (default: /var/lib/cm/fleet)"
    )
    parser.add_argument(
        "--import-to", type=Path, metavar="DIR", help="accept bundles from the fleet, and unpack them below this folder"
    )
    parser.add_argument(
        "--settings", type=Path, metavar="FILE", help="settings whose policy of signatures applies to bundles"
    )
    parser.add_argument(
        "--lease",
        type=parsed("a time of 1 s or more", float, lambda value: 1 <= value < 1e6),
        default=10.0,
        metavar="SECONDS",
        help="how long a bridge may hang before the fleet regards it as gone (10)",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted; the exit status."""
    logging.basicConfig(level=logging.INFO, format="cm bridge fleet: %(message)s", stream=sys.stderr)
    from cm.networks.fleet.zenoh_session import zenoh_module

    zenoh_module()  # if it is missing, this is said at once
    from cm.networks.fleet.bridge.bridge_process import Bridge

    bridge = Bridge(_options(args), lambda board: logging.getLogger("cm.fleet").info("ready as %s", board))
    return run_until_told(bridge.run)


def _options(args: argparse.Namespace) -> Options:
    from cm.networks.fleet import keys
    from cm.networks.fleet.bridge.bridge_process import Options, default_state
    from cm.networks.fleet.zenoh_session import endpoint, metadata_of

    listen = tuple(map(endpoint, args.listen))
    network = network_of(args, listen=listen, mode="peer" if listen else "client", lease=args.lease)
    for label in args.label:
        keys.check(label, "label")
    return Options(
        network,
        args.state_dir or default_state(),
        args.connect,
        args.runtime_dir,
        args.keys,
        _name(args.name, network.config),
        tuple(args.label),
        _importer(args.import_to, args.settings) if args.import_to else None,
        args.join or bool(metadata_of(network.config, "name")),
        args.keeper,
    )


def _name(asked: str, config: Path | None) -> str:
    """The board's: that of its certificate, under which alone the router lets it through. Raises InvalidRequest."""
    from cm.networks.fleet import keys
    from cm.networks.fleet.zenoh_session import metadata_of

    certified = metadata_of(config, "name")
    if asked and certified and asked != certified:
        raise InvalidRequest(
            f"--name {asked}: the certificate in {config} is that of {certified!r}, and the router lets no other name "
            f"through; leave --name out, or make one with `cm fleet keys DIR board {asked}`"
        )
    return keys.check(asked, "board") if asked else certified


def _importer(out: Path, settings: Path | None) -> Import:
    """What ``cm import archive`` does, under the same policy."""
    from cm.cli.import_ import read_settings, unpack_signed

    read_settings(settings)  # what is wrong with them is said now, and not when an archive comes

    def take(archive: Path) -> tuple[str, str]:
        out.mkdir(parents=True, exist_ok=True)
        done, found = unpack_signed(archive, out, settings)
        return done.config.name, found.signer or ""

    return take
