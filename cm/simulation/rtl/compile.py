# SPDX-License-Identifier: Apache-2.0
"""HDL to shared libraries with the table of harness/model.h, and the harness itself."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterable, Iterator, Set
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from cm.frozen import dataclass
from cm.simulation.rtl.cache import cache_folder, digest, made
from cm.simulation.rtl.errors import RtlError
from cm.simulation.rtl.tools import Tools

HARNESS = Path(__file__).parent / "harness"
_FLAGS = ("-std=c++17", "-fPIC", "-fvisibility=hidden", "-pthread", "-DVL_USER_FINISH", "-DVL_USER_STOP",
          "-DVL_USER_FATAL", "-DVL_USER_WARN", "-DVL_TIME_CONTEXT")  # fmt: skip
_VERILATOR = ("--cc", "-O3", "--x-assign", "unique", "--x-initial", "unique", "--timescale", "1ns/1ps",
              "--prefix", "Vmodel", "-Wno-fatal", "-Wno-lint", "-Wno-style")  # fmt: skip
_VERILOG = "+1364-2005ext+v"  # a .v is Verilog: `bit`, `do` and `int` are names there
_SEVERITY = re.compile(rb"\$(?:fatal|error|warning|info)\b")  # SystemVerilog's, which Vivado takes in a .v too
_PIN = re.compile(r"VL_(INOUT|IN|OUT)(8|16|64|W)?\(&(\w+),(\d+),(\d+)(?:,\d+)?\);")
_LOCAL = re.compile(r"^    [CS]Data(/\*[0-9:]+\*/ )(\w+);", re.MULTILINE)
_ADDRESS = re.compile(r"&\(?(\w+)")
_MISSING = re.compile(r"Cannot find file containing module: '(\w+)'")
_NOISE = re.compile(r"/\*.*?\*/|//[^\n]*|\(\*(?!\s*\)).*?\*\)|`[^\n]*|\bspecify\b.*?\bendspecify\b", re.DOTALL)
_MODULE = re.compile(r"\bmodule\s+(\w+)\b([^;]*);(.*?)\bendmodule\b", re.DOTALL)
_DECLARES = re.compile(r"(?:input|output|inout|wire|reg|logic|parameter|localparam)\b")
_DIRECTION = {"IN": "CM_IN", "OUT": "CM_OUT", "INOUT": "CM_INOUT"}


class _NotThere(RtlError):
    """Modules without HDL."""

    def __init__(self, what: str, names: Set[str]) -> None:
        super().__init__(
            f"{what}: no HDL is there for {', '.join(sorted(names))}: add its sources, or, for a vendor's core, "
            "sim_sources: with HDL that does the same (yosys, where it is installed, has the vendor's primitives)"
        )
        self.names = names


@dataclass(frozen=True, slots=True)
class Unit:
    """What becomes one library: a top module, its files, and text that is not in a file."""

    name: str  # for messages
    top: str
    sources: tuple[Path, ...]
    includes: tuple[Path, ...] = ()
    defines: tuple[str, ...] = ()
    made: Path | None = None  # folder of files that are written for the simulation, anew each time

    @property
    def folders(self) -> tuple[Path, ...]:
        """Where files are that the HDL reads (`$readmemh`): beside it, or in its folders of includes."""
        beside = (path.parent for path in self.sources if self.made is None or self.made not in path.parents)
        return tuple(dict.fromkeys([*beside, *self.includes]))

    @property
    def empty(self) -> list[str]:
        """Modules that it uses and whose text only declares outputs: black boxes, which would give 0 for ever."""
        text = b"\n".join(_texts(self.sources)).decode(errors="replace")
        found = [name for name, filled in _modules(text) if not filled]
        return [name for name in sorted(set(found)) if len(re.findall(rf"\b{name}\b", _NOISE.sub(" ", text))) > 1]

    @property
    def reads_files(self) -> bool:
        """Whether the HDL names any."""
        return any(b"$readmem" in text or b"$fopen" in text for text in _texts(self.sources))


@dataclass(frozen=True, slots=True)
class Watched:
    """What libraries can do beside running, more slowly."""

    traces: bool = False  # write what signals do

    @property
    def key(self) -> str:
        """For the cache."""
        return f"traces={self.traces}"

    @property
    def macros(self) -> list[str]:
        """Of Verilator's runtime."""
        return [f"-DVM_TRACE={int(self.traces)}", f"-DVM_TRACE_FST={int(self.traces)}", "-DVM_TRACE_VCD=0"]


NOTHING = Watched()


def compile_units(tools: Tools, units: Iterable[Unit], watched: Watched = NOTHING, jobs: int = 2) -> list[Path]:
    """The library of each unit, compiled or from the cache. Raises RtlError with what Verilator says about the HDL."""
    if watched.traces and not tools.traces:
        raise RtlError("traces need zlib's header: apt-get install zlib1g-dev")
    runtime = _runtime(tools, watched)
    with ThreadPoolExecutor(jobs) as pool:
        return list(pool.map(lambda unit: _library(tools, unit, runtime, watched), units))


def compile_harness(tools: Tools) -> Path:
    """The program that runs the libraries."""
    files = sorted(HARNESS.glob("*.cpp"))
    key = digest([tools.identity, *_texts([*files, *HARNESS.glob("*.h")])])

    def make(target: Path, _: Path) -> None:
        _run([tools.compiler, "-std=c++17", "-O3", "-o", str(target), *map(str, files), "-ldl"], "the harness")

    return made(cache_folder(), f"harness-{key}", make)


def _runtime(tools: Tools, watched: Watched) -> Path:
    """Verilator's own sources as one object: they are most of what there is to compile."""
    names = [
        "verilated.cpp",
        "verilated_threads.cpp",
        "verilated_dpi.cpp",
        *(["verilated_fst_c.cpp"] if watched.traces else []),
    ]
    found = [tools.include / name for name in names if (tools.include / name).exists()]
    newer = tools.include / "verilated_random.cpp"  # of Verilator 5.024 and later
    found += [newer] if newer.exists() else []
    key = digest([tools.identity, str(tools.include), *_FLAGS, watched.key])

    def make(target: Path, scratch: Path) -> None:
        objects = []
        for source in found:
            objects.append(scratch / f"{source.stem}.o")
            command = [tools.compiler, "-c", "-O1", *_FLAGS, *watched.macros, *_include(tools)]
            _run([*command, "-o", str(objects[-1]), str(source)], source.name)
        _run(["ld", "-r", "-o", str(target), *map(str, objects)], "Verilator's runtime")

    return made(cache_folder(), f"runtime-{key}.o", make)


def _library(tools: Tools, unit: Unit, runtime: Path, watched: Watched) -> Path:
    if unit.empty:
        raise RtlError(
            f"{unit.name}: nothing is in {', '.join(unit.empty)}, so that their outputs would be 0: "
            "give sim_sources: with HDL that does what these black boxes do"
        )
    inputs = [*unit.sources, *(file for folder in unit.includes for file in sorted(folder.glob("*.*h")))]
    shim = (HARNESS / "shim.cpp.in").read_text(encoding="utf-8")
    header = (HARNESS / "model.h").read_text(encoding="utf-8")
    described = [tools.identity, unit.top, watched.key, *unit.defines, *_VERILATOR, _VERILOG, *_FLAGS, _LOCAL.pattern]
    key = digest([*described, shim, header, *_texts(inputs)])

    def make(target: Path, scratch: Path) -> None:
        _verilate(tools, unit, scratch / "model", watched)
        _link(tools, unit, scratch, runtime, target, watched)

    return made(cache_folder(), f"{unit.top}-{key}.so", make)


def _verilate(tools: Tools, unit: Unit, folder: Path, watched: Watched) -> None:
    command = [tools.verilator, *_VERILATOR, "--top-module", unit.top, "--Mdir", str(folder)]
    command += ["--no-timing"] if tools.timing else []  # HLS writes `#0` in what it makes; a delay is none here
    command += ["--trace-fst"] if watched.traces else []
    command += [f"-I{path}" for path in unit.includes] + [f"-D{define}" for define in unit.defines]
    try:
        _read(command, unit, folder.parent)
    except _NotThere as missing:
        cells = tools.primitives
        there = {name for name, filled in _modules(cells.read_text(encoding="utf-8")) if filled} if cells else set()
        if not missing.names <= there:
            raise
        _read([*command, "-v", str(cells)], unit, folder.parent)


def _read(command: list[str], unit: Unit, scratch: Path) -> None:
    """Have the sources read as SystemVerilog, else a .v as Verilog. Raises what is wrong with the first."""
    try:
        _run([*command, *map(str, unit.sources)], unit.name)
    except _NotThere:
        raise
    except RtlError as as_system_verilog:
        try:
            _run([*command, _VERILOG, *_as_verilog(unit, scratch)], unit.name)
        except _NotThere:
            raise
        except RtlError:
            raise as_system_verilog from None


def _as_verilog(unit: Unit, folder: Path) -> Iterator[str]:
    """The sources for a run in which a .v is Verilog; those that need more than that, under another name."""
    for number, source in enumerate(unit.sources):
        if source.suffix == ".v" and _SEVERITY.search(source.read_bytes()):
            link = folder / f"{source.stem}.{number}.sv"
            link.unlink(missing_ok=True)
            link.symlink_to(source.absolute())
            yield str(link)
        else:
            yield str(source)


def _link(tools: Tools, unit: Unit, scratch: Path, runtime: Path, target: Path, watched: Watched) -> None:
    """One compilation of everything that Verilator wrote, for the optimiser and for speed."""
    folder = scratch / "model"
    pins = list(_pins((folder / "Vmodel.h").read_text(encoding="utf-8")))
    if not pins:
        raise RtlError(f"{unit.name}: {unit.top} has no ports")
    parts = sorted(path for path in folder.glob("*.cpp"))
    shim = (HARNESS / "shim.cpp.in").read_text(encoding="utf-8")
    shim = shim.replace("@PINS@", "\n".join(f'\t{{"{name}", {bits}, {way}}},' for name, _, bits, way in pins))
    cases = (f"\tcase {index}: return &top.{member};" for index, (_, member, _, _) in enumerate(pins))
    shim = shim.replace("@WHERE@", "\n".join(cases))
    whole = scratch / "whole.cpp"
    for path in parts:
        path.write_text(widened(path.read_text(encoding="utf-8")), encoding="utf-8")
    whole.write_text("".join(f'#include "{path}"\n' for path in parts) + shim, encoding="utf-8")
    speed = "-O1" if watched.traces else "-O3"  # a traced library is slow anyway, and is recompiled often
    command = [tools.compiler, speed, *_FLAGS, *watched.macros, *_include(tools), f"-I{folder}", f"-I{HARNESS}"]
    command += [
        "-shared",
        "-fno-gnu-unique",
        "-Wl,-Bsymbolic",
        "-Wl,--wrap=fopen",
        "-o",
        str(target),
        str(whole),
        str(runtime),
    ]
    _run([*command, *(["-lz"] if watched.traces else [])], unit.name)


def widened(code: str) -> str:
    """Verilator's C++ with local variables of 8 and 16 bits in words of 32.

    Compilers store them as bytes and load them again as words, and the processor waits for each: a third of the time
    of a simulation. Their values are as wide as the HDL's either way (Verilator masks to 32 bits of C++). Variables
    whose address is taken are left as they are.
    """
    taken = set(_ADDRESS.findall(code))
    return _LOCAL.sub(lambda found: found[0] if found[2] in taken else f"    IData{found[1]}{found[2]};", code)


def _pins(header: str) -> Iterator[tuple[str, str, int, str]]:
    """Name in the HDL, member of the class, bits and direction of each port."""
    for way, _, member, high, low in _PIN.findall(header):
        yield member.removeprefix("__SYM__"), member, int(high) - int(low) + 1, _DIRECTION[way]


def _include(tools: Tools) -> list[str]:
    return [f"-I{tools.include}", f"-I{tools.include / 'vltstd'}"]


def _modules(text: str) -> Iterator[tuple[str, bool]]:
    """The modules of some Verilog, and whether anything is in them; ports without outputs need nothing."""
    for name, ports, body in _MODULE.findall(_NOISE.sub(" ", text)):
        outputs = re.findall(r"\boutput\b[^,;)]*", ports + body)
        declares = all(not part.strip() or _DECLARES.match(part.strip()) for part in body.split(";"))
        yield name, not outputs or not declares or any("=" in one for one in outputs)


def _texts(files: Iterable[Path]) -> list[bytes]:
    try:
        return [file.read_bytes() for file in files]
    except OSError as error:
        raise RtlError(f"{error.filename}: {error.strerror}") from None


def _run(command: list[str], what: str) -> None:
    done = subprocess.run(
        command, capture_output=True, text=True, errors="replace", check=False, stdin=subprocess.DEVNULL
    )
    if done.returncode:
        missing = set(_MISSING.findall(done.stderr))
        if missing:
            raise _NotThere(what, missing)
        said = [line for line in (done.stderr + done.stdout).splitlines() if "rror" in line] or [done.stderr[-2000:]]
        raise RtlError(f"{what} does not compile:\n  " + "\n  ".join(said[:20]))
