# SPDX-License-Identifier: Apache-2.0
"""Recipes of the layer as tests read them, and what the package's modules really import."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LAYER = ROOT / "yocto/meta-cm"
PACKAGE = ROOT / "cm"
_ASSIGNMENT = re.compile(r'^([A-Z_]+(?::[\w${}\-:]+)?) *(\+|\?|\?\?|:)?= *"((?:[^"\\]|\\.|\\\n)*)"', re.MULTILINE)

# Python's standard library is split: module → package. From python3-manifest.json of openembedded-core,
# scarthgap 5435505 and wrynose ef022bf; what is not named here is in python3-core.
SPLIT = {
    "asyncio": "asyncio", "bz2": "compression", "concurrent": "asyncio", "ctypes": "ctypes", "curses": "curses",
    "datetime": "datetime", "decimal": "numbers", "difflib": "difflib", "fcntl": "fcntl", "gzip": "compression",
    "hashlib": "crypt", "html": "html", "http": "netclient", "json": "json", "logging": "logging", "mmap": "mmap",
    "lzma": "compression", "multiprocessing": "multiprocessing", "pickle": "pickle", "queue": "threading",
    "secrets": "netclient", "shlex": "shell", "socket": "io", "socketserver": "netserver", "ssl": "io",
    "statistics": "statistics", "tarfile": "compression", "tempfile": "io", "termios": "io", "base64": "netclient",
    "hmac": "netclient", "resource": "resource", "tty": "terminal", "pty": "terminal", "urllib": "netclient",
    "sqlite3": "sqlite3", "uuid": "netclient", "xml": "xml", "zipfile": "compression",
}  # fmt: skip
OTHERS = {
    "_cffi_backend": "python3-cffi", "aiohttp": "python3-aiohttp", "cffi": "python3-cffi",
    "fastjsonschema": "python3-fastjsonschema",
    "google": "python3-protobuf", "jinja2": "python3-jinja2", "numpy": "python3-numpy", "yaml": "python3-pyyaml",
    "zmq": "python3-pyzmq",
}  # fmt: skip
# In no layer of meta-openembedded, or of use to few: `cm` says what is missing where they are needed.
OPTIONAL = {
    "pytest",  # of whoever runs tests
    "argcomplete", "cocotb", "foxglove", "grpc_tools", "iceoryx2", "isal", "matplotlib", "mcap", "mcap_ros2", "PIL",
    "cryptography", "pyslang", "scipy",
    "systemrdl", "tree_sitter", "tree_sitter_vhdl", "xxhash", "zenoh", "setuptools",
}  # fmt: skip


def variables(recipe: Path) -> dict[str, str]:
    """Plain assignments of a recipe and of what it requires; later ones with += are joined."""
    found: dict[str, str] = {}
    required = re.findall(r"^require (\S+)$", recipe.read_text(), re.MULTILINE)
    text = "".join(path.read_text() for path in (*(recipe.parent / name for name in required), recipe))
    for name, operator, value in _ASSIGNMENT.findall(text):
        words = " ".join(value.replace("\\\n", " ").split())
        found[name] = f"{found[name]} {words}" if operator == "+" and name in found else words
    return found


def depends(values: dict[str, str], suffix: str) -> set[str]:
    """What a package of the main recipe depends on, lists that have names of their own opened out."""
    text = values.get(f"RDEPENDS:${{PN}}{suffix}:append:class-target", "")
    return packages(re.sub(r"\$\{(CM_\w+)\}", lambda found: values[found[1]], text))


def packages(text: str) -> set[str]:
    """Names in a list of dependencies, without their versions, and without those that hang on the image."""
    return set(re.sub(r"\$\{@[^}]*\}|\([^)]*\)", "", text).split())


def files_of(recipe: Path) -> dict[str, list[str]]:
    """Package suffix ("" for the main one) → patterns of the files below cm/ that are its own."""
    found = {}
    for name, value in variables(recipe).items():
        if name.startswith("FILES:${PN}"):
            parts = [part.removeprefix("${CM}/") for part in value.split() if part.startswith("${CM}/")]
            found[name.removeprefix("FILES:${PN}")] = parts
    return found


def owner(path: Path, files: dict[str, list[str]]) -> str:
    """The suffix of the package that a module of cm/ is in: the first whose patterns match, as do_package has it."""
    name = path.relative_to(PACKAGE).as_posix()
    for suffix, patterns in files.items():
        if any(_matches(name, pattern) for pattern in patterns):
            return suffix
    return ""


def _matches(name: str, pattern: str) -> bool:
    return name.startswith(f"{pattern}/") or ("/" not in name and fnmatch(name, pattern))


def imported(path: Path) -> Iterator[str]:
    """Modules that a file imports, wherever in it, but for annotations' sake."""
    yield from _imported(ast.parse(path.read_text(encoding="utf-8")).body)


def _imported(body: list[ast.stmt]) -> Iterator[str]:
    for statement in body:
        if isinstance(statement, ast.If) and "TYPE_CHECKING" in ast.unparse(statement.test):
            continue
        for node in [statement] if isinstance(statement, (ast.Import, ast.ImportFrom)) else []:
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            yield from names
        for field in ("body", "orelse", "finalbody", "handlers"):
            yield from _imported(
                [s for s in getattr(statement, field, []) if isinstance(s, (ast.stmt, ast.excepthandler))]
            )  # type: ignore[misc]


def needed(path: Path) -> set[str]:
    """Packages of the distribution that a module of ours takes."""
    found = {"python3-core"}
    for name in imported(path):
        head = name.partition(".")[0]
        if head in sys.stdlib_module_names and head not in OPTIONAL:
            found.add(f"python3-{SPLIT.get(head, 'core')}")
        elif head not in OPTIONAL and head != "cm":
            found.add(OTHERS[head])
    if path.name == "call.py" and path.parent.name == "native":
        found.add("python3-cffi")  # the compiled module's runtime
    return found
