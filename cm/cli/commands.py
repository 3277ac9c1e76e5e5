# SPDX-License-Identifier: Apache-2.0
"""The commands of `cm`: a static table, so that ``cm --help`` imports none of them."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from typing import ClassVar, NamedTuple, Protocol, cast

from cm.errors import CmError


class Command(NamedTuple):
    """A command, the module that has it, and its help in one line."""

    name: str
    module: str
    help: str
    linux: bool = False  # it needs a board, or what Linux has


class CommandModule(Protocol):
    """The interface of a command's module. `add_parser` adds a parser with ``set_defaults(run=run)``."""

    def add_parser(self, subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None: ...


class CommandMissing(CmError):
    """A command of the table whose module, or a package that it needs, is not installed."""

    code: ClassVar[str] = "command_missing"


COMMANDS = (
    Command("serve", "cm.cli.serve", "run the configuration manager", linux=True),
    Command("sim", "cm.cli.sim", "serve a simulated board", linux=True),
    Command("status", "cm.cli.status", "show what is loaded and what is going on"),
    Command("watch", "cm.cli.watch", "follow the status as it changes"),
    Command("configs", "cm.cli.configs", "list the configurations and their modes"),
    Command("load", "cm.cli.load", "load a configuration"),
    Command("mode", "cm.cli.mode", "change the mode"),
    Command("cancel", "cm.cli.cancel", "cancel the running change"),
    Command("plan", "cm.cli.plan", "show what a change of mode would do"),
    Command("reg", "cm.cli.reg", "list, read, write and watch registers"),
    Command("mem", "cm.cli.mem", "list, read and write memories"),
    Command("irq", "cm.cli.irq", "list interrupts and wait for them"),
    Command("lease", "cm.cli.lease", "take, list and break leases"),
    Command("stream", "cm.cli.stream", "list, set, capture and play data streams"),
    Command("data", "cm.cli.data", "configure the data channels"),
    Command("view", "cm.cli.view", "show a stream in the terminal or a window"),
    Command("web", "cm.cli.web", "serve a page that shows a board in a browser"),
    Command("fleet", "cm.cli.fleet", "watch many boards, and change them together"),
    Command("bridge", "cm.cli.bridge", "connect a board to another network: ROS 2, fleets", linux=True),
    Command("bitstream", "cm.cli.bitstream", "inspect, verify and convert bitstreams", linux=True),
    Command(
        "import",
        "cm.cli.import_",
        "make a runtime schema from a dfx-mgr or PYNQ package, or unpack an archive",
        linux=True,
    ),
    Command("config", "cm.cli.config", "list and roll back versions of imported configurations"),
    Command("build", "cm.cli.build", "make bitstreams, overlays and runtime schemas from HDL", linux=True),
    Command("keygen", "cm.cli.keygen", "make keys for connections over TCP"),
    Command(
        "doctor", "cm.cli.doctor", "report what this machine has, what it lacks, and what to do about it", linux=True
    ),
    Command("demo", "cm.cli.demo", "run the camera demonstration on a simulated board", linux=True),
    Command("bench", "cm.cli.bench", "measure latency and throughput", linux=True),
    Command("conformance", "cm.cli.conformance", "test a client, or a manager, against the wire protocol", linux=True),
    Command("check", "cm.cli.check", "check runtime schemas"),
    Command("completion", "cm.cli.completion", "print a completion script for a shell"),
    Command("help", "cm.cli.help", "describe a command"),
)


def find_command(name: str) -> Command | None:
    """The command called `name`."""
    return next((command for command in COMMANDS if command.name == name), None)


def add_command(command: Command, subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Import `command` and add its parser; raises `CommandMissing` if it, or a package that it needs, is missing."""
    if command.linux and sys.platform != "linux":
        raise CommandMissing(
            f"`cm {command.name}` is for the board, or another machine with Linux. What talks to a board works here: "
            "cm status --connect tcp://kria.local"
        )
    try:
        cast(CommandModule, import_module(command.module)).add_parser(subparsers)
    except ModuleNotFoundError as error:
        if error.name == command.module:
            raise CommandMissing(f"the command {command.name} is not part of this installation") from error
        sentence = f"the command {command.name} needs the Python module {error.name}, which is not installed"
        raise CommandMissing(sentence) from error
    except ImportError as error:  # a library of another version, or our own that was not built
        raise CommandMissing(f"the command {command.name} cannot be used here: {error}") from error
