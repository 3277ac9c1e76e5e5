# SPDX-License-Identifier: Apache-2.0
"""What all commands share that use the fleet's network."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cm.cli.common import Run, add_json_option, answer_table, seconds
from cm.cli.parser import Parser
from cm.wire.messages.json_values import plain

if TYPE_CHECKING:
    from cm.networks.fleet.blocking import Fleet
    from cm.networks.fleet.zenoh_session import Network


ALL = ["*"]  # boards, where none is named


class Intermixed(Parser):
    """Options may stand between arguments: ``mode edge --policy quorum b1 b2``, where boards would be unknown else."""

    _inside = False

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As the parser of the commands above calls it, and argparse within that for options and arguments apart."""
        if self._inside:
            return argparse.ArgumentParser.parse_known_args(self, args, namespace)
        return super().parse_known_args(args, namespace)

    def _known(self, args: list[str], namespace: Any) -> tuple[Any, list[str]]:
        if any(action.nargs == argparse.PARSER for action in self._actions):
            return super()._known(args, namespace)
        self._inside = True
        try:
            return self.parse_known_intermixed_args(args, namespace)
        finally:
            self._inside = False


def add_network_options(parser: argparse.ArgumentParser) -> None:
    """Add ``--router``, ``--zenoh-config`` and ``--store``: where the fleet is, and with which certificate."""
    group = parser.add_argument_group("network")
    group.add_argument(
        "--router",
        action="append",
        default=[],
        metavar="HOST[:PORT]",
        help="the fleet's router, or zenoh's tls/HOST:PORT (default: $CM_FLEET, else whoever answers on this network)",
    )
    group.add_argument(
        "--zenoh-config", type=Path, metavar="FILE", help="zenoh's own settings, as `cm fleet keys` writes them"
    )
    group.add_argument(
        "--store",
        default="",
        metavar="WHERE",
        help="where the wanted state is: keeper, etcd's https://HOST:2379,…, or a file about etcd (default: "
        "$CM_FLEET_STORE, else what --zenoh-config says, else keeper)",
    )


def network_of(args: argparse.Namespace, **more: object) -> Network:
    """What these options say. Raises InvalidRequest."""
    from cm.networks.fleet.zenoh_session import Network, endpoint, from_environment

    connect = tuple(map(endpoint, args.router))
    if not connect and args.zenoh_config is None:
        connect = from_environment()
    return Network(connect=connect, config=args.zenoh_config, store=args.store, **more)  # type: ignore[arg-type]


def add_fleet_options(parser: argparse.ArgumentParser, run: Run, boards: bool = True) -> None:
    """Add the boards, the options of `add_network_options`, the time-out, ``--json``, and `run`."""
    if boards:
        parser.add_argument(
            "boards", nargs="*", default=ALL, metavar="BOARD", help="a name, a glob or @LABEL (default: all)"
        )
    add_network_options(parser)
    group = parser.add_argument_group("asking")
    group.add_argument(
        "--timeout", type=seconds, default=10.0, metavar="SECONDS", help="how long to wait for an answer (10)"
    )
    add_json_option(parser, run)


def connected_fleet(args: argparse.Namespace) -> Fleet:
    """The fleet that the options name. Raises NoNetwork."""
    from cm.networks.fleet.blocking import connect
    from cm.networks.fleet.zenoh_session import endpoint

    routers = tuple(map(endpoint, args.router))
    return connect(routers, config=args.zenoh_config, timeout=args.timeout, store=args.store)


def answer_boards(
    args: argparse.Namespace,
    found: Mapping[str, Any],
    headers: Sequence[str],
    row: Callable[[str, Any], tuple[object, ...]],
    fine: Callable[[Any], bool] = lambda _: True,
    as_json: Callable[[Any], Any] = plain,
    unknown: str = "",
) -> int:
    """Print what each board answered, by name, as a table of `row` or as JSON.

    Returns the exit status: 1 where a board is not `fine`, or could not answer, which its last column says, behind
    `unknown` in the second.
    """
    from cm.wire.messages.status import ErrorInfo

    silent = {name: each for name, each in found.items() if isinstance(each, ErrorInfo)}
    nothing = (unknown, *[""] * (len(headers) - 3))
    rows = [(n, *nothing, silent[n].message) if n in silent else row(n, each) for n, each in found.items()]
    answer_table(args, {name: as_json(each) for name, each in found.items()}, rows, headers)
    return int(bool(silent) or not all(fine(each) for each in found.values()))
