# SPDX-License-Identifier: Apache-2.0
"""The commands of `cm`: a static table, so that ``cm --help`` imports none of them."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from typing import ClassVar, NamedTuple

from cm.errors import CmError


class Command(NamedTuple):
    """A command, the module that has it, and its help in one line.

    The module's ``fill_parser``, or ``add_NAME`` if it has several commands, gets the command's parser.
    """

    name: str
    module: str
    help: str
    group: str = ""  # what it is for
    linux: bool = False  # it needs a board, or what Linux has


class CommandMissing(CmError):
    """A command of the table whose module, or a package that it needs, is not installed."""

    code: ClassVar[str] = "command_missing"


# The ten of a person's day; `cm --help` begins with them, and has the others below, by what they are for.
DAY = ("serve", "status", "watch", "load", "mode", "plan", "reg", "stream", "bitstream", "build")

COMMANDS = (
    Command("status", "cm.cli.status", "show what is loaded and what is going on", "board"),
    Command("watch", "cm.cli.status", "follow the status as it changes", "board"),
    Command("load", "cm.cli.change", "load a configuration, or go to one of its modes", "board"),
    Command("mode", "cm.cli.change", "change the mode", "board"),
    Command("unload", "cm.cli.change", "empty a region, or all of them", "board"),
    Command("plan", "cm.cli.change", "show what a change of mode would do", "board"),
    Command("cancel", "cm.cli.change", "cancel the running change", "board"),
    Command(
        "doctor",
        "cm.cli.doctor",
        "report what this machine has, what it lacks, and what to do about it",
        "board",
        linux=True,
    ),
    Command("why", "cm.cli.why", "explain a board's state, now or in a record", "board"),
    Command("reg", "cm.cli.reg", "list, read, write and watch registers", "data"),
    Command("mem", "cm.cli.mem", "list, read and write memories", "data"),
    Command("irq", "cm.cli.irq", "list interrupts and wait for them", "data"),
    Command("stream", "cm.cli.stream", "list, set, capture and play data streams", "data"),
    Command("view", "cm.cli.view", "show a stream in the terminal", "data"),
    Command("record", "cm.cli.record", "record what a board does", "data", linux=True),
    Command("replay", "cm.cli.replay", "run a record again on a simulated board", "data", linux=True),
    Command("lease", "cm.cli.lease", "take, list and break leases", "sharing"),
    Command("keygen", "cm.cli.keygen", "make keys for connections over TCP", "sharing"),
    Command("config", "cm.cli.config", "list, send, check and roll back configurations", "designs"),
    Command(
        "import",
        "cm.cli.import_",
        "make a runtime schema from a dfx-mgr or PYNQ package, or unpack an archive",
        "designs",
        linux=True,
    ),
    Command("region", "cm.cli.region", "compare a region with what was loaded, repair it, draw it", "designs"),
    Command("bitstream", "cm.cli.bitstream", "inspect, verify, convert and move bitstreams", "designs", linux=True),
    Command("build", "cm.cli.build", "make bitstreams, overlays and runtime schemas from HDL", "designs", linux=True),
    Command("web", "cm.cli.web", "serve a page that shows a board in a browser", "networks"),
    Command("fleet", "cm.cli.fleet", "watch many boards, and change them together", "networks"),
    Command("bridge", "cm.cli.bridge", "connect a board to another network: ROS 2, fleets", "networks", linux=True),
    Command("serve", "cm.cli.serve", "run the configuration manager", "run", linux=True),
    Command("sim", "cm.cli.sim", "serve a simulated board", "run", linux=True),
    Command("demo", "cm.cli.demo", "run the camera demonstration on a simulated board", "try", linux=True),
    Command("bench", "cm.cli.bench", "measure latency and throughput", "try", linux=True),
    Command("conformance", "cm.cli.conformance", "test a client against the wire protocol", "try", linux=True),
    Command("completion", "cm.cli.completion", "print a completion script for a shell", "shell"),
)

_SHORT = {"check": ["config", "check"], "configs": ["config", "list"]}


def understood(words: list[str]) -> list[str]:
    """A command line with short spellings of commands in full; what follows a ``--`` is not ours."""
    at = next((at for at, word in enumerate(words) if not word.startswith("-")), len(words))
    before, name, rest = words[:at], words[at : at + 1], words[at + 1 :]
    if name == ["help"]:
        return [*before, *understood(rest), "--help"]
    if name == ["fleet"] and rest[:1] == ["ls"]:
        rest = ["list", *rest[1:]]
    if name == ["record"] and not {*rest[:1]} & {"start", "repair", "plot", "-h", "--help"}:
        rest = ["start", *rest]  # a file may stand there, which argparse would take for an action
    return [*before, *_SHORT.get(name[0], name), *rest] if name else words


def find_command(name: str) -> Command | None:
    """The command called `name`."""
    return next((command for command in COMMANDS if command.name == name), None)


def nearest(name: str) -> str | None:
    """A command with a similar name, or with a short spelling that is."""
    import difflib  # only those who err need it

    known = {command.name: command.name for command in COMMANDS}
    known |= {short: " ".join(full) for short, full in _SHORT.items() if full[0] in known}
    found = difflib.get_close_matches(name, known, n=1)
    return known[found[0]] if found else None


def add_command(command: Command, subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Import `command` and add its parser; raises `CommandMissing` if it, or a package that it needs, is missing."""
    if command.linux and sys.platform != "linux":
        raise CommandMissing(
            f"`cm {command.name}` is for the board, or another machine with Linux. What talks to a board works here: "
            "cm status --connect tcp://kria.local"
        )
    try:
        module = import_module(command.module)
        fill = getattr(module, f"add_{command.name}", None) or module.fill_parser
        fill(subparsers.add_parser(command.name, help=command.help))
    except ImportError as error:
        raise missing(command.name, command.module, error) from error


def missing(command: str, module: str, error: ImportError) -> CommandMissing:
    """The error for a command whose `module`, or what that needs, cannot be imported."""
    if not isinstance(error, ModuleNotFoundError):  # a library of another version, or our own that was not built
        return CommandMissing(f"the command {command} cannot be used here: {error}")
    if error.name == module:
        return CommandMissing(f"the command {command} is not part of this installation")
    return CommandMissing(f"the command {command} needs the Python module {error.name}, which is not installed")
