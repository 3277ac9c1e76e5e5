# SPDX-License-Identifier: Apache-2.0
"""`cm build init --from zypr`: a project file of the paper's authors (github.com/accl-kaust/zypr) as a build schema.

Their JSON names device, regions with pblocks, modules with sources, and which modules a region may hold. Sources are
looked for in `design_directory`, by their path or else by their name, since some of their files leave the folder out.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from cm.design.boundary.make import boundary
from cm.design.errors import BuildError
from cm.design.hdl.extract import Sources
from cm.design.hdl.hls_registers import hls_interface
from cm.design.hdl.model import Interface, Mode, ModuleInfo
from cm.design.input_kinds import read_inputs
from cm.design.platforms import platform_of
from cm.formats.registers import identifier
from cm.frozen import dataclass
from cm.schema.clock_rates import PLL, hertz, rate_problem, rounded
from cm.schema.model import Clock

_RATE = 100  # MHz, where the file says none
_LINES, _COLUMNS = 480, 640  # of a frame, which the file does not say
_BEATS = {8: "uint8", 16: "uint16", 32: "uint32", 64: "uint64"}  # bits of a beat that is one element
_SITES = ("SLICE", "DSP48E2", "RAMB18", "RAMB36", "URAM288")  # that can be reconfigured
_KEPT = {"config_zypr", "design_directory", "design_default_mode", "design_mode", "project_name", "project_device"}


@dataclass(frozen=True, slots=True)
class _Module:
    """`called`: its names in lists of what a region may hold."""

    name: str
    called: frozenset[str]
    top: str
    sources: tuple[str, ...]
    further: Mapping[str, Sequence[str]]  # keys of the build schema for vendor IP
    info: ModuleInfo


def zypr_text(path: Path, folder: Path) -> str:
    """Return the text of a build schema in `folder` for a project file. Raises BuildError for what it cannot be."""
    try:
        project = json.loads(path.read_text(encoding="utf-8"))
        return "\n".join(_lines(project, path, folder)) + "\n"
    except OSError as error:
        raise BuildError(f"{path} cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        what = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        raise BuildError(f"{path} is no project file of zypr: {what}") from None


def _lines(project: Mapping[str, Any], path: Path, folder: Path) -> Iterator[str]:
    design, device = project["design"], project["project"]["project_device"]
    mode = design["design_mode"][design["design_default_mode"]]
    part = "".join(device[key] for key in ("device", "package", "speed", "option"))
    clock = "fclk0" if platform_of(part).name == "zynq7000" else "pl0"
    rate = project["config"].get("config_zypr", {}).get("clock_freq", _RATE)
    regions, doubled = _regions(mode["pr_regions"])
    modules = list(_modules(mode, path.parent / design["design_directory"], folder))
    video = mode.get("settings", {}).get("dma") == "video"
    yield "# yaml-language-server: $schema=build.schema.json"
    yield f"# Build schema, begun by `cm build init --from zypr {path.name}`. Every key is explained in docs/build.md."
    yield f"# Not taken over, as nothing here is the like: {', '.join(_left(project, design))}."
    yield ""
    yield f"project: {{name: {identifier(project['project']['project_name'])}, part: {part}}}"
    yield ""
    yield from _clock(clock, rate * 1_000_000, clock == "pl0")
    yield ""
    yield "regions:"
    first = ""
    for name, region in regions.items():
        held = [module for module in modules if module.called & set(region["valid_configs"])]
        if not held:
            raise BuildError(
                f"{path}: region {name} may hold {', '.join(region['valid_configs'])}, none of its modules"
            )
        first = first or _default_mode(mode, regions, name, held)
        yield f"  {name}:"
        ranges = " ".join(region["pblock"]).split()
        kept = [one for one in ranges if one.startswith(_SITES)]
        yield f"    pblock: [{', '.join(kept)}]"
        if kept != ranges:
            yield f"    # the static part's: {', '.join(one for one in ranges if one not in kept)}"
        yield f"    clock: {clock}"
        yield from _interfaces(name, [module.info for module in held], video)
    yield from (f"  # {name}: left out, as its sites are those of {other}" for name, other in doubled.items())
    yield ""
    yield "modules:"
    for module in modules:
        places = [name for name, region in regions.items() if module.called & set(region["valid_configs"])]
        yield f"  {module.name}:"
        yield f"    top: {module.top}"
        yield f"    regions: [{', '.join(places)}]"
        yield from _listed("sources", module.sources)
        for key, files in module.further.items():
            yield from _listed(key, files)
        registers = [source for source in module.sources if source.endswith("_s_axi.v")]
        if len(registers) == 1:
            yield f"    register_map: {registers[0]}"
        elif registers:
            yield "    register_map:"
            yield from (f"      {hls_interface(Path(source), module.top)}: {source}" for source in registers)
    yield ""
    yield f"default_mode: {first}"


def _regions(given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Regions by name, and those whose pblock is another's, with its name."""
    by_sites: dict[str, str] = {}
    first = {name: by_sites.setdefault(" ".join(region["pblock"]), name) for name, region in given.items()}
    return (
        {name: region for name, region in given.items() if first[name] == name},
        {name: other for name, other in first.items() if other != name},
    )


def _default_mode(mode: Mapping[str, Any], regions: Mapping[str, Any], name: str, held: Sequence[_Module]) -> str:
    """The mode of a region's default module, called as modes are where none are listed."""
    wanted = {identifier(one) for one in mode["configs"][regions[name]["default_config"]]["modules"]}
    module = next((one for one in held if one.name in wanted), held[0])
    several = sum(bool(module.called & set(other["valid_configs"])) for other in regions.values()) > 1
    return f"{module.name}_{name}" if several else module.name


def _left(project: Mapping[str, Any], design: Mapping[str, Any]) -> list[str]:
    named = [*project["config"], *project["project"], *design, *project.get("linux", {})]
    return [name for name in named if name not in _KEPT]


def _modules(mode: Mapping[str, Any], rtl: Path, folder: Path) -> Iterator[_Module]:
    for config in mode["configs"].values():
        for name, module in config["modules"].items():
            found = _found(module["rtl"], rtl)
            inputs = read_inputs(Sources(found, module["top_cell"]))[0]
            if not inputs:
                raise BuildError(f"module {name}: its files have no module {module['top_cell']}")
            further = {
                key: [_below(file, folder) for file in _found(module.get(key, ()), rtl)] for key in ("ip", "tcl")
            }
            yield _Module(
                identifier(name),
                frozenset({name, module["top_cell"]}),
                module["top_cell"],
                tuple(_below(file, folder) for file in found),
                {key: files for key, files in further.items() if files},
                inputs[0].flat,
            )


def _found(names: Sequence[str], rtl: Path) -> list[Path]:
    """Files by path, or by name where one folder, that of most of the others, has one of it."""
    there = {name: [rtl / name] if (rtl / name).is_file() else sorted(rtl.rglob(name)) for name in names}
    missing = [name for name, files in there.items() if not files]
    if missing:
        raise BuildError(f"{rtl} holds no {', '.join(missing)}")
    most = Counter(file.parent for files in there.values() for file in files)
    return [max(files, key=lambda file: (most[file.parent], str(file))) for files in there.values()]


def _interfaces(region: str, infos: Sequence[ModuleInfo], video: bool) -> Iterator[str]:
    streams = [
        interface
        for interface in boundary({info.name: info for info in infos}).interfaces
        if interface.protocol == "axis"
    ]
    if streams:
        yield "    interfaces:    # shape and dtype are guesses: write those of your frames"
    for interface in streams:
        way = "to" if interface.mode is Mode.SLAVE else "from"
        alike = [one for one in streams if one.mode is interface.mode]
        name = f"{way}_{region}" + (f"_{interface.name}" if len(alike) > 1 else "")
        engine = f"connect: vdma, engine: {region}, " if video and "TLAST" in interface.ports else ""
        yield f"      {interface.name}: {{{engine}stream: {name}, {_frame(interface)}}}"


def _frame(interface: Interface) -> str:
    width = interface.data_width or 8
    shape = f"shape: [{_LINES}, {_COLUMNS}" + (f", {width // 8}]" if width not in _BEATS else "]")
    return shape + (f", dtype: {_BEATS[width]}" if width in _BEATS and width > 8 else "")


def _clock(name: str, rate: int, ultrascale: bool) -> Iterator[str]:
    """The clock, with as much tolerance as it takes where the I/O PLL has no such rate: Vivado rounds it too."""
    there = rounded(PLL["ultrascale+" if ultrascale else "7series"], rate)
    if rate_problem(Clock(name, rate), there):
        yield f"# With the I/O PLL of most boards it runs at {hertz(there)}."
        yield f"clocks: {{{name}: {{rate: {rate:_}, tolerance: {-(-100 * abs(rate - there) // rate)}}}}}"
    else:
        yield f"clocks: {{{name}: {{rate: {rate:_}}}}}"


def _listed(key: str, files: Sequence[str]) -> Iterator[str]:
    yield f"    {key}:"
    yield from (f"      - {file}" for file in files)


def _below(path: Path, folder: Path) -> str:
    try:
        return path.absolute().relative_to(folder).as_posix()
    except ValueError:
        return path.absolute().as_posix()
