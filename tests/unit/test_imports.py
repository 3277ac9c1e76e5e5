# SPDX-License-Identifier: Apache-2.0
"""Imports run one way: the table of docs/architecture.md, held."""

from __future__ import annotations

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "cm"
BASE = {"errors", "_version"}

# subpackage → subpackages that it may import
MAY = {
    "errors": set(),
    "_version": set(),
    "messages": set(),
    "multipart": set(),
    "fdt": set(),
    "child": set(),
    "loop": set(),
    "native": BASE,
    "bitstream": BASE | {"native", "schema.model"},
    "device": BASE | {"native"},
    "hwh": BASE,
    "schema": BASE,
    "settings": BASE | {"schema"},
    "manager": BASE | {"messages", "schema.model"},
    "wire": BASE | {"messages"},
    "daemon": BASE
    | {"fdt", "loop", "messages", "device", "bitstream", "schema", "manager", "wire", "native", "multipart"},
    "client": BASE | {"messages", "wire", "native", "multipart"},
    "sim": BASE | {"child", "fdt", "loop", "native", "schema", "bitstream", "hwh"},
    "importers": BASE | {"fdt", "schema", "bitstream", "hwh"},
    "build": BASE | {"fdt", "schema", "bitstream", "hwh", "sim"},
}


def imports(path: Path) -> set[str]:
    """Names below `cm` that a file imports, wherever in it."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    package = parts[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            module = ".".join(filter(None, (base, node.module)))
            found |= {module} if node.module else {f"{module}.{a.name}" for a in node.names}
    return {name.removeprefix("cm.") for name in found if name.startswith("cm.")}


def allowed(name: str, owner: str) -> bool:
    head = name.split(".", maxsplit=1)[0]
    return head == owner or head in MAY[owner] or any(name.startswith(m) for m in MAY[owner] if "." in m)


@pytest.mark.parametrize("owner", sorted(MAY))
def test_imports_run_one_way(owner: str) -> None:
    place = PACKAGE / owner
    files = sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]
    wrong = {
        f"{path.relative_to(PACKAGE)} imports cm.{name}"
        for path in files
        for name in imports(path)
        if not allowed(name, owner)
    }
    assert not wrong


def test_the_modules_of_the_manager_import_each_other_in_one_direction() -> None:
    modules = {_module(path): path for path in (PACKAGE / "manager").rglob("*.py")}
    graph = {name: imports(path) & modules.keys() - {name} for name, path in modules.items()}
    assert len(graph["manager.manager"]) > 10
    order = list(TopologicalSorter(graph).static_order())  # raises CycleError
    assert order[-1] == "manager.manager"


def _module(path: Path) -> str:
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def test_only_the_bindings_import_the_compiled_module() -> None:
    users = {p.relative_to(PACKAGE).parts[0] for p in PACKAGE.rglob("*.py") if "native._cm" in p.read_text("utf-8")}
    assert users == {"native"}


def test_only_the_codec_knows_protobuf() -> None:
    users = {p.relative_to(PACKAGE).parts[0] for p in PACKAGE.rglob("*.py") if "cm_pb2" in p.read_text("utf-8")}
    assert users <= {"wire", "demo", "bench"}


def test_the_manager_knows_no_sockets() -> None:
    users = {p.relative_to(PACKAGE).parts[0] for p in PACKAGE.rglob("*.py") if "import zmq" in p.read_text("utf-8")}
    assert not users & {"manager", "schema", "bitstream", "device", "native", "messages", "sim", "wire"}


_WITHOUT_SHIMS = """
import importlib, pkgutil, sys

for compiled in ("cm.native", "cm.device", "cm.bitstream", "cffi", "zmq", "google"):
    sys.modules[compiled] = None  # importing it raises ImportError
import cm.manager

for module in pkgutil.walk_packages(cm.manager.__path__, "cm.manager."):
    importlib.import_module(module.name)
print(len([name for name in sys.modules if name.startswith("cm.manager.")]))
"""


def test_the_manager_imports_where_no_shim_was_compiled() -> None:
    done = subprocess.run(
        [sys.executable, "-c", _WITHOUT_SHIMS], capture_output=True, text=True, check=False, cwd=PACKAGE.parent
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 30
