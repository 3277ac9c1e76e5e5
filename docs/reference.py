# SPDX-License-Identifier: Apache-2.0
"""Write the pages of the public API from its docstrings: ``python docs/reference.py [FOLDER]`` (``build/reference``).

The package is read, not imported (griffe), so that the pages are the same wherever they are made.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import griffe

DOCS = Path(__file__).parent
FOLDER = DOCS.parent / "build" / "reference"

# Page → its title, what it is for, and the modules whose public names stand on it. A module with __all__, or one that
# imports names as themselves, shows those; another what it defines, or what stands behind a colon.
PAGES: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "client": (
        "The blocking client",
        "`cm.connect()` gives a `Board`; the rest hangs on it. [The guide](../../docs/client.md).",
        (
            "cm.client.board", "cm.client.registers", "cm.client.register_window", "cm.client.core.generations",
            "cm.client.interrupts",
            "cm.client.memories", "cm.client.blocks", "cm.client.stream", "cm.client.frame", "cm.client.mapping",
            "cm.client.writer",
            "cm.client.allocation", "cm.client.change", "cm.client.lease", "cm.client.events", "cm.client.picture",
            "cm.client.find_manager", "cm.wire.plane_packets:Geometry Descriptor",
        ),
    ),
    "aio": (
        "The asyncio client",
        "`cm.aio.connect()`: the same names, awaited. [What differs](../../docs/client.md).",
        (
            "cm.client.aio.board", "cm.client.aio.registers", "cm.client.aio.interrupts", "cm.client.aio.memories",
            "cm.client.aio.stream", "cm.client.aio.writer", "cm.client.aio.change", "cm.client.aio.lease",
            "cm.client.aio.events",
        ),
    ),
    "messages": (
        "What the manager tells",
        "Statuses, plans, descriptions, events.",
        ("cm.wire.messages._proto", "cm.wire.messages.status"),
    ),
    "errors": (
        "Errors",
        "Each has a stable `code`; [what each means](../../docs/reconfiguration.md#errors).",
        ("cm.errors", "cm.client.errors"),
    ),
    "device": ("Devices", "Without a manager. [The guide](../../docs/device.md).", ("cm.device",)),
    "sim": (
        "The simulated board",
        "From Python, for tests. [The guide](../../docs/simulator.md).",
        (
            "cm.simulation.software", "cm.simulation.software.hardware.board_spec:ModuleSpec",
            "cm.simulation.software.hardware.board_spec:ChannelSpec",
            "cm.simulation.software.hardware.board_spec:RegionSpec",
            "cm.simulation.software.hardware.board_spec:WindowSpec",
        ),
    ),
    "schema": (
        "Runtime schemas",
        "Loading and checking them. [The format](../../docs/schema.md).",
        ("cm.schema", "cm.schema.model", "cm.schema.pictures"),
    ),
    "fleet": (
        "Many boards",
        "`cm.fleet.connect()` gives a `Fleet` whose calls block, `cm.fleet.aio.connect()` one whose calls are awaited: "
        "the same names, arguments and errors. [The guide](../../docs/fleet.md).",
        (
            "cm.networks.fleet.aio", "cm.networks.fleet.coordinator:Course Leg",
            "cm.networks.fleet.queries:Answer", "cm.networks.fleet.errors:NoSuchBoard FleetRefused ChangeFailed",
            "cm.networks.fleet.zenoh_session:NoNetwork",
            "cm.networks.fleet.store:View Wanted Claim Settings Entry StoreAway StoreRefused",
            "cm.wire.messages.fleet:BoardStatus FleetState Policy Decision BundleState",
        ),
    ),
    "bitstream": (
        "Bitstreams",
        "Read, checked, converted. [The guide](../../docs/bitstreams.md).",
        ("cm.formats.bitstream", "cm.formats.bitstream.inspection_report:Section"),
    ),
}  # fmt: skip

# Of the modules above: what is there for other modules of the package.
INTERNAL = {
    "cm.client.mapping": {"SlotMappings", "Lease", "lend"},
    "cm.client.allocation": {"allocated"},
    "cm.client.core.generations": {"FirstAfter", "number"},
    "cm.client.picture": {"has_rows"},
    "cm.client.find_manager": {"default_runtime_dir", "find", "resolve", "Place", "SYSTEM_DIR"},
    "cm.client.frame": {"frame_of"},
    "cm.client.errors": {"request_error"},
    "cm.client.stream": {"NewestStream", "RemoteStream"},
    "cm.client.aio.stream": {"AsyncRemoteStream"},
}
MEMBERS_INTERNAL = {"ask", "run", "subscribe", "end", "disown", "nothing"}  # for what hangs on a board
_DUNDERS = {"__getitem__", "__setitem__", "__iter__", "__len__", "__contains__", "__array__"}
_PLAIN_BASES = ("Generic", "Protocol", "Guarded", "shown.")
_PREFACE = (
    "Made from docstrings by `make docs`. `Limit` is a time-out in seconds, or None, which waits for "
    "ever; left out (`DEFAULT`) it is that of the board or of the stream."
)
_SECTION = re.compile(r"^(Args|Arguments|Returns|Raises|Yields):$")


def pages() -> dict[str, str]:
    """Names of files and their text."""
    package: Any = griffe.load("cm", search_paths=[str(DOCS.parent)])
    made = {f"{name}.md": _page(package, name) for name in PAGES}
    rows = [f"| [{title}]({name}.md) | {about} |" for name, (title, about, _) in PAGES.items()]
    made["README.md"] = "\n".join(["# Python reference", "", _PREFACE, "", "| page | |", "|---|---|", *rows, ""])
    return made


def _page(package: Any, name: str) -> str:
    title, about, _ = PAGES[name]
    lines = [f"# {title}", "", about, ""]
    for where, found in public(package, name):
        lines += _object(where, found)
    return "\n".join(lines).rstrip() + "\n"


def public(package: Any, page: str) -> Iterator[tuple[str, Any]]:
    """The objects of a page, each with the module that users import it from."""
    for module in PAGES[page][2]:
        module, _, only = module.partition(":")
        found = package[module.removeprefix("cm.")]
        for name in only.split() or _names(found):
            member = found.members[name]
            target = member.final_target if member.is_alias else member
            if target.is_class or target.is_function:
                yield module, target


def _names(module: Any) -> Sequence[str]:
    """What a module offers, in its order of definition."""
    if module.exports:
        return [name for name in module.members if name in {str(e) for e in module.exports}]
    own = [n for n, m in module.members.items() if _is_shown(m) and not n.startswith("_")]
    given = [n for n, m in module.members.items() if m.is_alias and m.target_path.endswith(f".{n}") and not own]
    return [name for name in own + given if name not in INTERNAL.get(module.path, set())]


def _is_shown(member: Any) -> bool:
    return not member.is_alias and (member.is_class or member.is_function)


def _object(module: str, found: Any) -> list[str]:
    lines = [f"## `{found.name}`", "", f"From `{_import_from(module)}`.", ""]
    if found.is_function:
        return [*lines, *_signature(found, found.name), *_text(found)]
    bases = [str(base) for base in found.bases if not str(base).startswith(_PLAIN_BASES)]
    lines += [*([f"A kind of {', '.join(f'`{base}`' for base in bases)}.", ""] if bases else []), *_text(found)]
    start = found.members.get("__init__")
    if start is not None and not start.is_alias and start.docstring is not None:
        lines += [*_signature(start, found.name), *_text(start)]
    lines += _fields(found)
    inherited = [base.members for base in found.resolved_bases if base.name == "Operations"]  # of a board
    for name, member in ({**inherited[0], **found.members} if inherited else found.members).items():
        if is_public(name, member) and (member.is_function or "property" in member.labels):
            lines += _member(found, member)
    return lines


def is_public(name: str, member: Any) -> bool:
    """Whether a member of a class is for users: it has a docstring, and no name that says otherwise."""
    hidden = name in MEMBERS_INTERNAL or (name.startswith("_") and name not in _DUNDERS)
    return not (hidden or member.is_alias or member.docstring is None)


def _import_from(module: str) -> str:
    return {
        "cm.client.board": "cm",
        "cm.client.picture": "cm",
        "cm.wire.messages._proto": "cm.wire.messages.status",
        "cm.client.aio.board": "cm.aio",
        "cm.networks.fleet.blocking": "cm.networks.fleet",
    }.get(module, module)


def _fields(found: Any) -> list[str]:
    """Attributes of the class's body: a table with types, defaults and what stands beside them."""
    rows = [
        (name, member, _beside(member))
        for name, member in found.members.items()
        if member.is_attribute and "property" not in member.labels and not name.startswith("_")
    ]
    if not rows:
        return []
    lines = ["| attribute | type | default | |", "|---|---|---|---|"]
    for name, member, note in rows:
        lines.append(f"| `{name}` | {_cell(member.annotation)} | {_cell(member.value)} | {note} |")
    return [*lines, ""]


def _cell(code: Any) -> str:
    if code is None:
        return ""
    text = str(code) if len(str(code)) <= 60 else str(code)[:57] + "..."
    return "`" + text.replace("|", "\\|").replace("\n", " ") + "`"


def _beside(member: Any) -> str:
    """The docstring below an attribute, or the comment behind it."""
    if member.docstring is not None:
        return " ".join(member.docstring.value.split())
    line = member.lines[-1] if member.lines else ""
    comment = re.search(r"  # (?!noqa|type:)(.*)$", line)
    return comment[1].replace("|", "\\|") if comment else ""


def _member(owner: Any, member: Any) -> list[str]:
    title = f"### `{owner.name}.{member.name}`"
    if "property" in member.labels:
        kind = "can be set" if "writable" in member.labels else "cannot be set"
        return [title, "", f"Property, {kind}: `{member.annotation}`.", "", *_text(member)]
    return [title, "", *_signature(member, member.name), *_text(member)]


def _signature(function: Any, name: str) -> list[str]:
    words: list[str] = []
    star = False
    for p in (p for p in function.parameters if p.name not in ("self", "cls")):
        kind = p.kind.name if p.kind is not None else ""
        if kind == "keyword_only" and not star:
            words.append("*")
            star = True
        prefix = {"var_positional": "*", "var_keyword": "**"}.get(kind, "")
        star = star or prefix == "*"
        typed = f": {p.annotation}" if p.annotation is not None else ""
        default = f" = {p.default}" if p.default is not None and not prefix else ""
        words.append(f"{prefix}{p.name}{typed}{default}")
    waits = "await " if "async" in function.labels else ""
    returns = f" -> {function.returns}" if function.returns is not None else ""
    line = f"{waits}{name}({', '.join(words)}){returns}"
    wide = f"{waits}{name}(\n    " + ",\n    ".join(words) + f",\n){returns}"
    return ["```python", line if len(line) <= 110 else wide, "```", ""]


def _text(found: Any) -> list[str]:
    """The docstring: paragraphs as they are, the arguments as a list."""
    if found.docstring is None:
        return []
    lines: list[str] = []
    inside = False
    for line in found.docstring.value.splitlines():
        if _SECTION.match(line.strip()) and not line.startswith(" "):
            inside = True
            lines += ["", f"{line.strip()}", ""] if lines and lines[-1] else [line.strip(), ""]
        elif inside and line.startswith("    ") and not line.startswith("     "):
            name, colon, rest = line.strip().partition(":")
            lines.append(f"- `{name}`:{rest}" if colon else f"- {line.strip()}")
        elif inside and line.startswith("     "):
            lines[-1] += f" {line.strip()}"
        else:
            inside = inside and not line.strip()
            lines.append(line)
    return [*lines, ""]


def write(folder: Path) -> None:
    """Write all pages."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        (folder / name).write_text(text, "utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]) if sys.argv[1:] else FOLDER)
