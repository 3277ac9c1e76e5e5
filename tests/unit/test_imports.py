# SPDX-License-Identifier: Apache-2.0
"""Imports run one way, and never in a circle; tests/unit/test_architecture.py holds the pages that say so."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from import_graph import ImportGraph

PACKAGE = Path(__file__).resolve().parents[2] / "cm"
GRAPH = ImportGraph(PACKAGE)
BASE = {"errors", "_version"}

# subpackage → subpackages that it may import
MAY = {
    "errors": set(),
    "_version": set(),
    "messages": set(),
    "budgets": {"errors", "messages"},
    "multipart": set(),
    "intake": {"budgets", "multipart"},
    "zap": set(),
    "fdt": set(),
    "child": set(),
    "loop": set(),
    "lazy_numpy": set(),
    "metrics": {"errors", "loop"},
    "native": BASE,
    "bitstream": BASE | {"native", "schema.model"},
    "device": BASE | {"native"},
    "xray": BASE,
    "hwh": BASE,
    "schema": BASE,
    "rights": BASE | {"messages", "schema.model"},
    "settings": BASE | {"schema", "rights"},
    "signing": BASE,
    "manager": BASE | {"messages", "metrics", "schema.model"},
    "wire": BASE | {"messages"},
    "daemon": BASE
    | {
        "budgets",
        "intake",
        "rights",
        "zap",
        "fdt",
        "loop",
        "messages",
        "metrics",
        "device",
        "bitstream",
        "schema",
        "manager",
        "wire",
        "native",
        "multipart",
    },
    "aio": {"client"},
    "client": BASE | {"lazy_numpy", "messages", "wire", "native", "multipart"},
    "fleet": BASE | {"client", "messages", "wire"},
    "view": BASE,
    "web": BASE | {"client", "fleet", "messages", "view", "wire"},
    "sim": BASE | {"child", "fdt", "lazy_numpy", "loop", "native", "schema", "bitstream", "hwh"},
    "importers": BASE | {"fdt", "native", "schema", "bitstream", "hwh"},
    "build": BASE | {"fdt", "schema", "bitstream", "hwh", "sim", "xray"},
    "rtl": BASE | {"build", "lazy_numpy", "loop", "schema", "sim"},
    "bits": BASE | {"bitstream", "build", "rtl", "sim", "xray"},
    "bridge": BASE | {"client", "messages", "schema", "wire"},
    "ros": BASE | {"bridge", "client", "messages", "schema.pictures"},
    "dds": BASE | {"bridge", "ros"},
    "rmw_zenoh": BASE | {"bridge", "ros"},
    "conformance": BASE | {"client", "messages", "wire"},
    "testing": BASE | {"child", "client", "rtl", "sim"},
}


# Library → packages that may import it; a library that is not listed is not a dependency.
LIBRARIES = {
    "PIL": {"cli", "demo", "sim", "web"},
    "aiohttp": {"web"},
    "cffi": {"dds", "native"},
    "cryptography": {"fleet", "signing"},
    "cyclonedds": {"dds"},
    "fastjsonschema": {"schema"},
    "google": {"wire"},
    "jinja2": {"build"},
    "lz4": {"client", "daemon"},
    "numpy": {
        "bench",
        "bitstream",
        "bridge",
        "build",
        "cli",
        "client",
        "daemon",
        "dds",
        "demo",
        "device",
        "lazy_numpy",
        "native",
        "ros",
        "rtl",
        "sim",
        "view",
        "web",
    },
    "pyslang": {"build"},
    "pytest": {"testing"},
    "scipy": {"build"},
    "systemrdl": {"build"},
    "tree_sitter": {"build"},
    "tree_sitter_vhdl": {"build"},
    "yaml": {"build", "schema"},
    "zmq": {"bench", "cli", "client", "conformance", "daemon", "demo", "intake", "multipart", "zap"},
    "xxhash": {"rmw_zenoh"},
    "zenoh": {"fleet", "rmw_zenoh"},
}
FREE = {"bench", "cli", "demo"}  # may import all of ours; the baselines of the bench are libraries of their own


def owner_of(module: str) -> str:
    return module.split(".")[1]


def allowed(name: str, owner: str) -> bool:
    inner = name.removeprefix("cm.")
    head = inner.split(".", maxsplit=1)[0]
    return head == owner or head in MAY[owner] or any(f"{inner}.".startswith(f"{m}.") for m in MAY[owner] if "." in m)


def test_every_package_is_in_the_table() -> None:
    assert GRAPH.children("cm") - {"__main__"} == MAY.keys() | FREE


@pytest.mark.parametrize("owner", sorted(MAY))
def test_imports_run_one_way(owner: str) -> None:
    modules = [name for name in GRAPH.modules if f"{name}.".startswith(f"cm.{owner}.")]
    assert modules
    wrong = {f"{name} imports {of}" for name in modules for of in GRAPH.inside[name] if not allowed(of, owner)}
    assert not wrong


# What a Board hands out (a change, its registers) holds the Board and names its type: one object in several files.
WHOLES = {"cm.client.board", "cm.client.aio.board"}


def test_nothing_is_imported_in_a_circle() -> None:
    assert GRAPH.circle(except_types_of=WHOLES) == []


def test_libraries_are_imported_where_they_belong() -> None:
    wrong = {
        f"{name} imports {library}"
        for name in GRAPH.modules
        for library in {full.split(".")[0] for full in GRAPH.outside[name]} - sys.stdlib_module_names - {"cm"}
        if "." in name and owner_of(name) != "bench" and owner_of(name) not in LIBRARIES.get(library, ())
    }
    assert not wrong


def test_only_the_bindings_import_the_compiled_module() -> None:
    users = {
        owner_of(name) for name, found in GRAPH.outside.items() if any(f.startswith("cm.native._cm") for f in found)
    }
    users |= {owner_of(name) for name in GRAPH.modules if "native._cm" in GRAPH.modules[name].read_text("utf-8")}
    assert users == {"native"}


def test_only_the_codec_knows_protobuf() -> None:
    users = {owner_of(name) for name, path in GRAPH.modules.items() if "cm_pb2" in path.read_text("utf-8")}
    assert users <= {"wire", "conformance", "demo", "bench"}


# ---- the reader of imports itself -------------------------------------------------------


def tree(folder: Path, files: dict[str, str]) -> ImportGraph:
    """A package ``p`` of modules (``q.b`` is q/b.py) with their sources."""
    for name, text in files.items():
        path = folder / "p" / f"{name.replace('.', '/')}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        for package in (folder / "p", path.parent):
            (package / "__init__.py").touch()
        path.write_text(text)
    return ImportGraph(folder / "p")


@pytest.mark.parametrize(
    "line",
    [
        "import p.b",
        "import p.b as other",
        "from p import b",
        "from p.b import name",
        "from . import b",
        "from .b import name",
        "def f():\n    from p import b",
        "if TYPE_CHECKING:\n    from p.b import Name",
    ],
)
def test_every_form_of_an_import_is_seen(tmp_path: Path, line: str) -> None:
    graph = tree(tmp_path, {"a": line, "b": ""})
    assert graph.edges()["p.a"] == {"p.b"}


@pytest.mark.parametrize("line", ["import zmq", "from zmq import Context", "from google.protobuf import message"])
def test_every_form_of_an_import_of_a_library_is_seen(tmp_path: Path, line: str) -> None:
    assert {name.split(".")[0] for name in tree(tmp_path, {"a": line}).outside["p.a"]} <= {"zmq", "google"}
    assert tree(tmp_path, {"a": line}).outside["p.a"]


@pytest.mark.parametrize(
    "files",
    [
        {"a": "from p import b", "b": "import p.a"},
        {"a": "from p.b import x", "b": "def f():\n    from p import a"},
        {"q.__init__": "from p.q.b import x", "q.b": "from p import a", "a": "from p.q import x"},
        {"q.__init__": "from p.q.b import x", "q.b": "from p import q"},
        {"q.__init__": "from p.q.b import x", "q.b": "from p import a", "q.c": "", "a": "from p.q.c import x"},
    ],
)
def test_a_circle_through_a_package_itself_is_found_too(tmp_path: Path, files: dict[str, str]) -> None:
    assert tree(tmp_path, files).circle()


def test_a_circle_of_types_is_one_unless_it_is_excepted(tmp_path: Path) -> None:
    graph = tree(tmp_path, {"a": "import p.b", "b": "if TYPE_CHECKING:\n    from p.a import A"})
    assert graph.circle()
    assert graph.circle(except_types_of={"p.a"}) == []


def test_what_is_not_a_circle_is_not_reported(tmp_path: Path) -> None:
    files = {"q.__init__": "from p.q.b import x", "q.b": "from p.q.c import x", "q.c": "from p import a", "a": ""}
    assert tree(tmp_path, files).circle() == []


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


_ON_A_LAPTOP = (
    "import cm.aio, cm.client.aio.board, cm.client.board, cm.cli.status, cm.cli.reg, cm.cli.stream, cm.cli.mem\n"
)


@pytest.mark.parametrize("system", ["win32", "darwin"])
def test_the_clients_import_where_only_linux_things_are_missing(system: str, tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(_ON_A_LAPTOP)
    laptop = PACKAGE.parent / "tests/laptop.py"
    done = subprocess.run(
        [sys.executable, laptop, system, script],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(PACKAGE.parent)},
    )
    assert done.returncode == 0, done.stderr
