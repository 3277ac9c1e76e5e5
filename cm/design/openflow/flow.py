# SPDX-License-Identifier: Apache-2.0
"""`cm build run --flow open`: the generated tree → full and partial bitstreams."""

from __future__ import annotations

import json
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from cm.design.errors import BuildError
from cm.design.generate.inputs import module_files
from cm.design.generate.output_tree import write_whole
from cm.design.generate.verilog_module import Netlist
from cm.design.openflow import images
from cm.design.openflow.layout import layouts
from cm.design.openflow.netlists import MODULE_TOP, TOP, module_side, open_system, open_top, static_side
from cm.design.openflow.placement_attempt import Attempt, Context, Settings, Unroutable
from cm.design.openflow.relocatable_modules import MOVERS, moved_image, moves_of
from cm.design.openflow.rules import refuse_open
from cm.design.openflow.steps import Steps, Tell, key_of
from cm.design.openflow.synth import ROUTER, Sources, resolved, script, synthesise
from cm.design.openflow.tools import Tools
from cm.design.plan.system import Implementation, System
from cm.design.render import Renderer
from cm.formats.bitstream.memory import frames_in
from cm.formats.xray import Database, Feature, Wires, two_drivers

Features = frozenset[Feature]
OWN_RTL = tuple(sorted((Path(__file__).parent / "rtl").glob("*.v")))


class OpenFlow:
    """A run of the flow over the tree generated in `out`; intermediate files are in ``open/`` there."""

    def __init__(self, system: System, out: Path, tools: Tools, tell: Tell, settings: Settings) -> None:
        refuse_open(system)
        self.system = system
        self.out = out.absolute()
        self.folder = self.out / "open"
        self.tools = tools
        self.settings = settings
        self.tell = tell
        self.database = Database.open(system.project.part, tools.database)
        self.wires = Wires(self.database)
        self.layouts = layouts(system, self.database)
        self.moves = moves_of(system, self.layouts, self.database)
        self.steps = Steps(self.folder, tell)
        (clock,) = {region.spec.clock for region in system.regions}
        self.rate = system.project.clocks[clock].rate

    def run(self) -> list[str]:
        """Run the steps that are not up to date; return their names."""
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.out / "bitstreams").mkdir(exist_ok=True)
        with ThreadPoolExecutor(self.settings.jobs) as pool:
            tasks = [pool.submit(self._synthesise, name, sources) for name, sources in self._all_sources().items()]
            for task in tasks:
                task.result()
        self._bitstreams(*self._placed())
        return self.steps.ran

    def _placed(self) -> tuple[Features, dict[str, Features]]:
        """Place and route everything; if a module cannot be routed, start again with another static part."""
        known = self.folder / "unroutable.json"
        context = Context(
            self.system, self.database, self.wires, self.layouts, self.tools, self.settings, self.tell, self.folder,
            self.rate, set(json.loads(known.read_text("utf-8"))) if known.is_file() else set(),
        )  # fmt: skip
        tried: list[str] = []
        while True:
            attempt = Attempt(context, len(tried), self.steps.ran)
            try:
                found = attempt.run()
                break
            except Unroutable as problem:
                tried.append(str(attempt.seed))
                if len(tried) >= self.settings.statics:
                    raise Unroutable(
                        f"{problem}\n  the same happened with every static part, of seeds {', '.join(tried)}"
                    ) from None
                self.tell(
                    f"{str(problem).splitlines()[0].rstrip(':')} against the static part of seed {attempt.seed}: "
                    f"another static part, from seed {attempt.seed + self.settings.tries}"
                )
        write_whole(known, json.dumps(sorted(context.failed)).encode())
        return found

    def _all_sources(self) -> dict[str, Sources]:
        renderer = Renderer(self.system.project.folder, self.out, f"Generated from {self.system.project.source.name}.")
        library = sorted((self.out / "hdl/lib").glob("*.v"))
        made = [self._kept(path.name, path.read_bytes()) for path in OWN_RTL]
        made += [self._written(renderer, f"static_{r.name}", static_side(r)) for r in self.system.regions]
        made.append(self._written(renderer, TOP, open_top(self.system)))
        made.append(self._written(renderer, "cm_open_system", open_system(self.system)))
        spec = self.system.project.static
        plain = [path for path in spec.sources if path.suffix == ".v"]
        verilog = resolved([*made, self.out / "hdl/cm_static.v", *library, *plain])
        later = tuple(path for path in spec.sources if path.suffix == ".sv")
        found = {"static": Sources(TOP, verilog, later, include_dirs=spec.include_dirs, pads=True)}
        for one in self.system.placed:
            top = self._written(renderer, f"module_{one.region.name}", module_side(one.region))
            files = module_files(one, self.out)
            found[one.name] = Sources(
                MODULE_TOP,
                resolved([top, *files["verilog"]]),
                resolved(files["systemverilog"]),
                resolved(files["header"]),
                resolved(files["include_dirs"]),
                tuple(files["defines"]),
                dsp=any(text.startswith("DSP48") for text in one.region.spec.pblock),
            )
        return found

    def _written(self, renderer: Renderer, name: str, net: Netlist) -> Path:
        return self._kept(f"{name}.v", renderer.render("module.v.j2", {"net": net}).encode())

    def _kept(self, name: str, text: bytes) -> Path:
        path = self.folder / name
        if not path.is_file() or path.read_bytes() != text:
            write_whole(path, text)
        return path

    def _synthesise(self, name: str, sources: Sources) -> None:
        out = self.folder / f"{name}.json"
        place = self.system.project.folder.absolute()
        key = key_of(script(sources, out, place), ROUTER, self.tools.versions, *sources.files)
        work = partial(synthesise, self.tools.yosys, sources, out, place, name)
        self.steps.step(f"synth_{name}", f"synthesis of {name} by yosys", key, [out], work)

    def _bitstreams(self, static: frozenset[Feature], modules: dict[str, frozenset[Feature]]) -> None:
        system, name = self.system, self.system.full
        names = [one.name for one in system.implementations]
        outputs = {one: self.out / f"bitstreams/{one}.bit" for one in (name, *names)}
        outputs["blank"] = self.folder / "blank.bit"
        found = {one: sorted(features) for one, features in modules.items()}
        moves = {one: sorted(columns.items()) for one, columns in self.moves.items()}
        key = key_of(sorted(static), found, moves, *map(Path, (images.__file__, *MOVERS)))
        self.steps.step("bitstreams", "frames and bitstreams", key, list(outputs.values()),
                        partial(self._write, static, modules, outputs))  # fmt: skip
        self.tell(f"{system.project.name}: {len(names)} partial bitstreams in {self.out / 'bitstreams'}")

    def _write(
        self, static: frozenset[Feature], modules: dict[str, frozenset[Feature]], outputs: dict[str, Path]
    ) -> None:
        device, part, name = self.system.device, self.system.project.part, self.system.full
        base = images.frames_of(self.database, static | self.database.required, "the static part")
        number = images.user_id(base)
        write_whole(outputs["blank"], images.full_image(device, part, "blank", base, number))
        made: dict[str, bytes] = {}
        for one in self.system.placed:
            self._checked(one, static | modules[one.name])
            columns = self.layouts[one.region.name].columns
            frames = images.frames_of(self.database, static | self.database.required | modules[one.name], one.name)
            beyond = images.outside(columns, base, frames)
            if beyond:
                raise BuildError(f"module {one.name} changes frame {beyond[0]:08X}, which is not of its region")
            made[one.name] = images.partial_image(device, part, one.name, frames, columns, number)
        for origin, one in self.system.moved:
            made[one.name] = moved_image(origin, one, made[origin.name], self.moves[one.name], base, self.database)
        for module, data in made.items():
            write_whole(outputs[module], data)
        first = self.system.runs[0].values()
        whole = static | self.database.required | {f for module in first for f in modules.get(module, ())}
        frames = images.frames_of(self.database, whole, name)
        for module in first:
            if module not in modules:
                frames |= frames_in(made[module])[1]
        write_whole(outputs[name], images.full_image(device, part, name, frames, number))

    def _checked(self, one: Implementation, features: Iterable[Feature]) -> None:
        told = two_drivers(self.database, features)
        if told:
            raise BuildError(f"module {one.name} and the static part do not go together: {told[0]}")
