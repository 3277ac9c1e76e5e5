# SPDX-License-Identifier: Apache-2.0
"""Which module imports which, read from the source: every form of import, anywhere in a file."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterable, Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path


class ImportGraph:
    """The modules below a package's folder, and what each imports: of the package, and of others."""

    def __init__(self, package: Path) -> None:
        self.package = package
        self.modules = {self._name(path): path for path in sorted(package.rglob("*.py"))}
        self.inside: dict[str, set[str]] = {}
        self.outside: dict[str, set[str]] = {}
        self.types: dict[str, set[str]] = {}  # imports for the type checker only
        for name, path in self.modules.items():
            syntax = ast.parse(path.read_text(encoding="utf-8"))
            found = set(self._imports(name, path, ast.walk(syntax)))
            self.types[name] = found - set(self._imports(name, path, _run_nodes(syntax)))
            self.inside[name] = {module for module in found if module in self.modules}
            self.outside[name] = found - self.inside[name]

    def _name(self, path: Path) -> str:
        parts = path.relative_to(self.package.parent).with_suffix("").parts
        return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)

    def _imports(self, name: str, path: Path, nodes: Iterable[ast.AST]) -> Iterator[str]:
        home = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
        for node in nodes:
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                above = home[: len(home) - node.level + 1] if node.level else []
                base = ".".join([*above, *filter(None, [node.module])])
                yield from (self._target(base, alias.name) for alias in node.names)

    def _target(self, base: str, name: str) -> str:
        """``from cm import daemon`` imports the module cm.daemon, ``from cm import connect`` only cm."""
        inner = f"{base}.{name}"
        return inner if inner in self.modules or base.partition(".")[0] != self.package.name else base

    def edges(self) -> Mapping[str, set[str]]:
        """Module → modules that an import of it runs: those it names, and the packages that these lie in.

        The packages that a module lies in itself are left out, and so is the topmost: they are there before it.
        """
        return {name: self._run(name, named) - {name, self.package.name} for name, named in self.inside.items()}

    def _run(self, name: str, named: set[str]) -> set[str]:
        faces = {face for module in named for face in _above(module) if not f"{name}.".startswith(f"{face}.")}
        return named | faces

    def circle(self, except_types_of: Collection[str] = ()) -> list[str]:
        """Modules that import each other in a circle; empty if none do.

        Modules of `except_types_of` may be named for the type checker by any other.
        """
        edges = {name: of - (self.types[name] & set(except_types_of)) for name, of in self.edges().items()}
        try:
            tuple(TopologicalSorter(edges).static_order())
        except CycleError as error:
            return list(error.args[1])
        return []

    def children(self, package: str) -> set[str]:
        """Names of the modules and packages directly below a package."""
        depth = package.count(".") + 1
        return {name.split(".")[depth] for name in self.modules if name.startswith(f"{package}.")}

    def between(self, package: str) -> dict[str, set[str]]:
        """Child of a package → other children of it that it imports, anywhere below it."""
        depth = package.count(".") + 1
        found: dict[str, set[str]] = {child: set() for child in self.children(package)}
        for name, targets in self.edges().items():
            if name.startswith(f"{package}."):
                own = name.split(".")[depth]
                below = {t.split(".")[depth] for t in targets if t.startswith(f"{package}.")}
                found[own] |= below - {own}
        return found


def _above(module: str) -> Iterator[str]:
    parts = module.split(".")
    return (".".join(parts[:count]) for count in range(1, len(parts)))


def _run_nodes(syntax: ast.AST) -> Iterator[ast.AST]:
    """All nodes but those below ``if TYPE_CHECKING``."""
    for node in ast.iter_child_nodes(syntax):
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            continue
        yield node
        yield from _run_nodes(node)
