# SPDX-License-Identifier: Apache-2.0
"""Reads Verilog and SystemVerilog with slang (pyslang): modules with evaluated ports and parameters, no interfaces yet.

All files of one call form one compilation, so that packages and macros of included headers are known.
Every module is elaborated as if it were a top, which evaluates its ports; bodies are not elaborated,
so the modules that a module instantiates need not be given.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from cm.design.hdl.errors import HdlError, parser_missing
from cm.design.hdl.model import Language, ModuleInfo, Problem
from cm.design.hdl.usage import Body, Pins, verilog_body
from cm.design.hdl.verilog_ports import read_instance
from cm.frozen import dataclass

VERILOG_SUFFIXES = (".v", ".vh", ".vo", ".verilog")
# Vivado reads `.v` files as Verilog-2005, where `do`, `bit`, `final` are names. On line 1, to keep line numbers.
_VERILOG_KEYWORDS = '`begin_keywords "1364-2005" '
_AS = " read as "  # between the name of a file and its language, where slang is told both
_NUMBER = re.compile(r"[-+~(\d'].*", re.DOTALL)
_HINTS = {
    "DiagCode(CouldNotOpenIncludeFile)": ": name its folder (include_dirs:, or -I)",
    "DiagCode(UnknownDirective)": ": define it (defines:, or -D), or give the file that does before this one",
    "DiagCode(AssignmentRequiresParens)": ": == compares",
    "DiagCode(ExpectedIdentifier)": ": a name, and no keyword",
}
# errors inside a module that stop synthesis, with Vivado's numbers where they are known
_SEMANTIC = {
    "DiagCode(PortDoesNotExist)": "Synth 8-448",
    "DiagCode(UndeclaredIdentifier)": "Synth 8-1031",
    "DiagCode(ImplicitNetPortNoDefault)": "Synth 8-6735",
    "DiagCode(AssignmentRequiresParens)": "",  # `=` for `==`: the grammar of IEEE 1800 has it in parentheses only
}
# what IEEE 1800 forbids, and Vivado synthesises: `type(a) b;` without `var`, as in FINN's library
_TOLERATED = ("DiagCode(TypeRefDeclVar)",)
_COMMENTS = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
_SIGNAL = re.compile(r"([!~]?)\s*(\w+)")
_NAME = re.compile(r"[A-Za-z_]\w*")
_NETTYPE = re.compile(r"`default_nettype\s+(\w+)")
# members that declare a module's outside
_OUTER = (
    "PortDeclaration",
    "ParameterDeclarationStatement",
    "PackageImportDeclaration",
    "EmptyMember",
    "TimeUnitsDeclaration",
)
_FLAGS = ("AllowUseBeforeDeclare", "IgnoreUnknownModules", "AllowTopLevelIfacePorts", "AllowInvalidTop")


@dataclass(frozen=True, slots=True)
class Tree:
    """One parsed file: slang's tree, its problems, and the modules it declares."""

    path: Path
    language: Language
    syntax: Any
    errors: tuple[Problem, ...]
    modules: tuple[tuple[str, tuple[str, ...]], ...]  # name, and the names of the modules that it instantiates
    interfaces: tuple[str, ...]
    packages: tuple[str, ...]
    nodes: Mapping[str, Any]  # slang's declarations of the modules
    hollow: tuple[tuple[str, int], ...]  # modules with outputs and nothing inside, and their lines


def load_slang() -> ModuleType:
    """pyslang; `ParserMissing` where it is not installed."""
    try:
        import pyslang
        import pyslang.ast
        import pyslang.parsing
        import pyslang.syntax
    except ImportError as error:
        raise parser_missing("pyslang", "Verilog and SystemVerilog") from error
    return pyslang


def expression(value: str) -> str:
    """A parameter's value as a Verilog expression: numbers as they are, anything else as a string literal."""
    text = value.strip()
    if text in ("True", "False"):
        return str(int(text == "True"))
    if text.isdecimal() and int(text) >> 31:  # which slang, without a size, takes for a negative number or for none
        return f"64'd{text}"
    return text if _NUMBER.fullmatch(text) or (len(text) > 1 and text[0] == text[-1] == '"') else f'"{text}"'


def _utf8(path: Path) -> str:
    """Convert a path for slang, which expects UTF-8 in any locale; other bytes become question marks."""
    return os.fsencode(path).decode("utf-8", errors="replace")


class VerilogReader:
    """Parses each file once, then evaluates the modules asked for."""

    def __init__(self, include_dirs: Sequence[Path] = (), defines: Mapping[str, str] | None = None) -> None:
        self._slang = load_slang()
        self._sources = self._slang.SourceManager()
        self._engine = self._slang.DiagnosticEngine(self._sources)
        self._includes = [str(path) for path in include_dirs]
        self._defines = [f"{name}={value}" for name, value in (defines or {}).items()]
        self._trees: list[Tree] = []
        self._nodes: dict[str, Any] = {}  # the declarations of modules
        self._headers: list[Path] = []
        self._kept: list[Any] = []
        self._untyped = False

    def parse(self, path: Path, text: str) -> Tree:
        """Parse one file and keep it for `read`."""
        # A file of macros among the sources applies to the files after it, as in Vivado's compilation order; of several
        # of one name, that of the file's own folder.
        known = {header.name: header for header in self._headers if header.parent == path.parent}
        headers = [header for header in self._headers if known.get(header.name, header) == header]
        before = "".join(f'`include "{_utf8(header)}" ' for header in headers)
        # so does a default_nettype that a file leaves set
        before += "`default_nettype none " if self._untyped else ""
        kinds = _NETTYPE.findall(_COMMENTS.sub(" ", text)) if "`default_nettype" in text else []
        self._untyped = kinds[-1] == "none" if kinds else self._untyped
        tree = self._parse(path, before + text)
        self._trees.append(tree)
        for name, node in tree.nodes.items():
            self._nodes.setdefault(name, node)
        if not tree.modules and "`define" in text:
            self._headers.append(path.resolve())
        return tree

    def _parse(self, path: Path, text: str) -> Tree:
        if path.suffix.lower() not in VERILOG_SUFFIXES:
            return self._tree(path, text, Language.SYSTEMVERILOG)
        tree = self._tree(path, _VERILOG_KEYWORDS + text, Language.VERILOG)
        if not tree.errors:
            return tree
        # Many `.v` files use SystemVerilog all the same; the reading with fewer errors is taken as intended.
        other = self._tree(path, text, Language.SYSTEMVERILOG)
        return other if len(other.errors) < len(tree.errors) else tree

    def _tree(self, path: Path, text: str, language: Language) -> Tree:
        options = self._slang.parsing.PreprocessorOptions()
        if "`include" in text:  # the folders of all files, which slang takes one by one
            options.additionalIncludePaths = [str(path.parent), *self._includes]
        options.predefines = self._defines
        # Two readings of one file need two names in slang's source manager, and none may be the file's own: a header
        # that is included would be taken from there, with the keywords set above. The folder stays, for includes.
        name = f"{_utf8(path)}{_AS}{language.value}"
        bag = self._slang.Bag([options])
        try:
            syntax = self._slang.syntax.SyntaxTree.fromText(text, self._sources, _utf8(path), name, bag)
        except RuntimeError as error:  # what slang raises for endless nesting
            raise HdlError(f"{path}: the parser gave up: {error or 'too deeply nested'}") from error
        problems, root = tuple(self._problems(path, syntax)), syntax.root
        declared = root.members if root.kind.name == "CompilationUnit" else (root,)
        named = [d for d in declared if d.kind.name in ("ModuleDeclaration", "InterfaceDeclaration")]
        names = {d.header.name.valueText: d for d in named if d.header.name.valueText}
        modules = [(name, d) for name, d in names.items() if d.kind.name == "ModuleDeclaration"]
        return Tree(
            path,
            language,
            syntax,
            problems,
            modules=tuple((name, tuple(dict.fromkeys(_types(d.members)))) for name, d in modules),
            interfaces=tuple(name for name, d in names.items() if d.kind.name == "InterfaceDeclaration"),
            packages=tuple(d.header.name.valueText for d in declared if d.kind.name == "PackageDeclaration"),
            nodes=dict(modules),
            hollow=tuple((n, self._sources.getLineNumber(d.header.name.location)) for n, d in modules if _hollow(d)),
        )

    def _problems(self, path: Path, syntax: Any) -> Iterator[Problem]:
        # those of the files that `parse` puts before this one have been reported with themselves
        known = set(self._headers)
        for diagnostic in syntax.diagnostics:
            said, own = self._file(diagnostic)
            file = path if own else said  # which it includes
            if diagnostic.isError() and (own or file not in known):
                line = self._sources.getLineNumber(diagnostic.location)
                yield Problem(self._message(diagnostic), str(file), line, breaks=str(diagnostic.code) not in _TOLERATED)

    def _file(self, diagnostic: Any) -> tuple[Path, bool]:
        """The file that a diagnostic is in, and whether it is one that was parsed, and not included."""
        said = str(self._sources.getFileName(diagnostic.location))
        name, own, _ = said.rpartition(_AS)
        return Path(name if own else said).resolve(), bool(own)

    def _message(self, diagnostic: Any) -> str:
        try:
            message = str(self._engine.formatMessage(diagnostic))
            return message + _HINTS.get(str(diagnostic.code), "")
        except UnicodeDecodeError:  # the message quotes part of a character
            return f"syntax error ({diagnostic.code})"

    def read(self, names: Iterable[str], parameters: Mapping[str, str], below: Iterable[Path] = ()) -> list[ModuleInfo]:
        """Evaluate the ports of the modules named, with `parameters` set on each of them.

        `below`: the files in which an error stops synthesis of the one module that is named.
        """
        wanted = set(names)
        if not wanted:
            return []
        given = {name: expression(value) for name, value in parameters.items()}
        owners = {name: (tree, inside) for tree in reversed(self._trees) for name, inside in tree.modules}
        modules: list[ModuleInfo] = []
        for trees, some in self._groups({name: owners[name][0].path.parent for name in wanted}):
            compilation = self._compile(some, given, trees)
            found = self._semantic(compilation, below)
            for instance in compilation.getRoot().topInstances:
                tree, inside = owners[instance.name]
                errors = (*tree.errors, *found)
                read = (compilation, self._sources, instance, tree.path, tree.language, errors, inside, given)
                modules.append(read_instance(*read))
        return modules

    def _groups(self, homes: Mapping[str, Path]) -> Iterator[tuple[Sequence[Tree], set[str]]]:
        """Trees to compile, and the modules of `homes`, by name, to evaluate with them.

        Those of a folder that has packages or interfaces which another one has too see their own.
        """
        folders: dict[str, set[Path]] = {}
        for tree in self._trees:
            for unit in (*tree.interfaces, *tree.packages):
                folders.setdefault(unit, set()).add(tree.path.parent)
        own = {folder for found in folders.values() if len(found) > 1 for folder in found}
        groups: dict[Path | None, set[str]] = {}
        for name, folder in homes.items():
            groups.setdefault(folder if folder in own else None, set()).add(name)
        for first, names in groups.items():
            others = [tree for tree in self._trees if tree.path.parent != first]
            if first is None:
                yield self._trees, names
            else:
                mine = [tree for tree in self._trees if tree.path.parent == first]
                yield [*mine, *(tree for tree in others if tree.interfaces or tree.packages)], names

    def _nested(self, compilation: Any) -> bool:
        """Whether a port is an interface that has another one as a port: slang 12.1 crashes where it checks these."""
        interfaces = {name for tree in self._trees for name in tree.interfaces}
        ports = (port for instance in compilation.getRoot().topInstances for port in instance.body.portList)
        kinds = (port.interfaceDef for port in ports if port.kind.name == "InterfacePort")
        heads = (str(kind.syntax.header.ports) for kind in kinds if kind is not None and kind.syntax.header.ports)
        return any(interfaces & {*_NAME.findall(head)} for head in heads)

    def _semantic(self, compilation: Any, paths: Iterable[Path]) -> tuple[Problem, ...]:
        """Errors in these files that stop synthesis, once for each place."""
        problems: dict[Problem, None] = {}
        names = {path.resolve(): str(path) for path in paths}
        checked = bool(names) and not self._nested(compilation)
        for diagnostic in compilation.getSemanticDiagnostics() if checked else ():
            number = _SEMANTIC.get(str(diagnostic.code))
            if number is None:
                continue
            name = names.get(self._file(diagnostic)[0])
            if name is not None:  # not of modules that are unused
                line = self._sources.getLineNumber(diagnostic.location)
                message = self._message(diagnostic) + (f" [{number}]" if number else "")
                problems[Problem(message, name, line, breaks=True)] = None
        return tuple(problems)

    def body(self, module: str) -> tuple[Body, tuple[str, ...]] | None:
        """What a module does itself, and the names in its head; None if it is not known."""
        node = self._nodes.get(module)
        if node is None:
            return None
        try:
            text = _COMMENTS.sub(" ", str(node))
        except UnicodeDecodeError:  # a comment in another encoding
            return None
        return verilog_body(text, self._pins(node.members)), tuple(_NAME.findall(text.partition(";")[0]))

    def _pins(self, members: Iterable[Any]) -> Iterator[Pins]:
        """What instances are given at their ports, where that is a signal; "*": the signals of the ports' names."""
        for member in _instances(members):
            order = _order(self._nodes.get(member.type.valueText))
            for instance in member.instances[::2]:  # every second one is a comma
                pins: dict[str, tuple[str, bool]] = {}
                for place, connection in enumerate(instance.connections[::2]):
                    kind = connection.kind.name
                    if kind == "WildcardPortConnection":
                        pins["*"] = ("", False)
                        continue
                    named = kind == "NamedPortConnection"
                    name = connection.name.valueText if named else order[place] if place < len(order) else ""
                    inner = str(connection.expr).strip() if getattr(connection, "expr", None) is not None else name
                    match = _SIGNAL.fullmatch(inner)
                    pins |= {name: (match[2], match[1] != "")} if match and name else {}
                yield member.type.valueText, pins

    def elaborate(self, name: str, parameters: Mapping[str, str]) -> Any:
        """slang's body of a module as a top, with `parameters` as expressions. Raises `HdlError`."""
        compilation = self._compile({name}, parameters, self._trees)
        self._kept.append(compilation)  # what it returns does not keep it alive
        for instance in compilation.getRoot().topInstances:
            if instance.name == name:
                return instance.body
        raise HdlError(f"module {name} could not be elaborated")

    def _compile(self, names: set[str], parameters: Mapping[str, str], trees: Sequence[Tree]) -> Any:
        ast = self._slang.ast
        options = ast.CompilationOptions()
        flags = sum(int(getattr(ast.CompilationFlags, flag)) for flag in _FLAGS)
        options.flags = ast.CompilationFlags(flags)
        options.topModules = names
        options.paramOverrides = [f"{name}={value}" for name, value in parameters.items()]
        compilation = ast.Compilation(self._slang.Bag([options]))
        for tree in trees:
            compilation.addSyntaxTree(tree.syntax)
        return compilation


def _hollow(module: Any) -> bool:
    """Whether a module has outputs and nothing that drives them: a black box, or a stub of something missing."""
    if any(member.kind.name not in _OUTER for member in module.members):
        return False
    try:
        return re.search(r"\boutput\b", _COMMENTS.sub(" ", str(module))) is not None
    except UnicodeDecodeError:  # a comment in another encoding
        return False


def _types(members: Iterable[Any]) -> Iterator[str]:
    """Names of the modules instantiated directly."""
    return (member.type.valueText for member in _instances(members))


def _instances(members: Iterable[Any]) -> Iterator[Any]:
    """Instantiations, through generate constructs; statements are not descended into."""
    stack = list(members)[::-1]
    while stack:
        member = stack.pop()
        kind = member.kind.name
        if kind == "HierarchyInstantiation":
            yield member
        elif "Generate" in kind:
            stack.extend(_generated(member, kind)[::-1])


def _order(node: Any) -> list[str]:
    """The names of a module's ports, in order."""
    ports = node.header.ports.ports[::2] if node is not None and node.header.ports is not None else ()
    named = (getattr(port, "declarator", None) or getattr(port, "expr", None) for port in ports)
    return [str(one.name.valueText) if one is not None and hasattr(one, "name") else "" for one in named]


def _generated(member: Any, kind: str) -> list[Any]:
    """The members of a generate construct of that kind."""
    if kind in ("GenerateRegion", "GenerateBlock"):
        return list(member.members)
    if kind == "LoopGenerate":
        return [member.block]
    if kind == "IfGenerate":
        return [member.block, *([member.elseClause.clause] if member.elseClause is not None else [])]
    return [item.clause for item in member.items] if kind == "CaseGenerate" else []
