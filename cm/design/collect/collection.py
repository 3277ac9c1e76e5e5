# SPDX-License-Identifier: Apache-2.0
"""`cm build collect`: the output of our own flow or of any other → runtime schema, .bin files, overlays, archive."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from cm.design.collect import handoff, xsa
from cm.design.collect.collected import HEAD, Collected, Inputs, archive, compile_overlays, write_folder
from cm.design.collect.foreign import their_config
from cm.design.collect.images import (
    Image,
    check_different,
    check_generated,
    check_images,
    check_regions,
    footprint,
    read_images,
    to_bin,
    user_id_of,
)
from cm.design.errors import BuildError
from cm.design.generate.outputs import identified
from cm.design.plan.system import System
from cm.design.runtime.answers import Answers
from cm.design.runtime.schema import runtime_config, runtime_text
from cm.formats import hwh
from cm.hashes import sha256
from cm.schema import loads
from cm.schema.model import Config


def gather(paths: Iterable[Path], work: Path) -> Inputs:
    """Read all `paths`: files, folders (without subfolders), XSA and HDF archives, which are unpacked to `work`."""
    files: list[Path] = []
    for path in paths:
        if path.is_dir():
            files += sorted(entry for entry in path.iterdir() if entry.is_file())
        elif path.exists():
            files.append(path)
        else:
            raise BuildError(f"{path} does not exist")
    loose = {path.name for path in files}
    sources: dict[Path, str] = {}  # where unpacked files came from, for messages
    for path in [path for path in files if path.suffix.lower() in xsa.ARCHIVES]:
        # a file that lies beside the archive under the same name is newer than the one inside
        inside = [entry for entry in xsa.unpack(path, work) if entry.name not in loose]
        sources |= {entry: f"{path}: {entry.name}" for entry in inside}
        files += inside
    descriptions = [
        handoff.read_handoff(path, sources.get(path, "")) for path in files if path.suffix.lower() == ".hwh"
    ]
    images = read_images(path for path in files if path.suffix.lower() in (".bit", ".bin"))
    if not descriptions and not images:
        raise BuildError("neither a .hwh (or an XSA or HDF with one) nor a bitstream was given")
    return Inputs(tuple(descriptions), tuple(images))


def collect(paths: Iterable[Path], name: str | None = None) -> Collected:
    """Make a configuration from the files of any flow; `name` is the design's by default."""
    with tempfile.TemporaryDirectory() as work:
        inputs = gather(paths, Path(work))
        check_images(inputs.images, inputs.whole.device if inputs.whole else None)
        return _loadable(their_config(inputs, name))


def collect_ours(paths: Iterable[Path], system: System, answers: Answers, generated: Path) -> Collected:
    """Make the configuration of `system` from its flow's bitstreams; `generated`: the output folder, for overlays."""
    system = identified(system)
    check_generated(system, generated)
    with tempfile.TemporaryDirectory() as work:
        inputs = gather(paths, Path(work))
        check_images(inputs.images, system.device)
        if inputs.whole:
            check_addresses(system, inputs.whole.design)
        return _loadable(_our_config(inputs, system, answers, generated))


def _our_config(inputs: Inputs, system: System, answers: Answers, generated: Path) -> Collected:
    images = {image.name: image for image in inputs.images}
    missing = [one.name for one in system.implementations if one.name not in images]
    if missing:
        raise BuildError(f"no bitstream for {', '.join(missing)}: each module's is called <module>.bit")
    groups: dict[str, list[Image]] = {region.name: [] for region in system.regions}
    for one in system.implementations:
        image = images[one.name]
        if not image.report.partial:
            raise BuildError(f"{image.path.name} is a full bitstream; module {one.name} needs a partial one")
        groups[one.region.name].append(image)
    check_different(images[one.name] for one in system.implementations)
    notes = check_regions(groups)
    files = {f"{one.name}.bin": to_bin(images[one.name]) for one in system.implementations}
    full = images.get(system.full)
    if full is not None and full.report.partial:
        raise BuildError(f"{full.path.name} is a partial bitstream; it has to configure the whole device")
    mine = [images[one.name] for one in system.implementations] + ([full] if full else [])
    user_id, said = user_id_of(mine, generated)
    config = _with_images(runtime_config(system, answers), files, groups)
    if config.static is not None:
        config = replace(config, static=replace(config.static, user_id=user_id))
    if full is not None:
        files[f"{config.name}_full.bin"] = to_bin(full)
    sources = {path.stem: path.read_text(encoding="utf-8") for path in sorted((generated / "dts").glob("*.dtso"))}
    overlays, more = compile_overlays(sources)
    files |= overlays
    files[f"{config.name}.yaml"] = (HEAD + runtime_text(system, config) + "\n").encode()
    return Collected(config, files, (*notes, *said, *more))


def _with_images(config: Config, files: Mapping[str, bytes], groups: Mapping[str, list[Image]]) -> Config:
    """Return `config` with the files' checksums, and with the frames that the regions own."""
    modules = {name: replace(module, sha256=sha256(files[f"{name}.bin"])) for name, module in config.modules.items()}
    regions = {name: replace(region, footprint=footprint(groups[name])) for name, region in config.regions.items()}
    return replace(config, modules=modules, regions=regions)


def check_addresses(system: System, design: hwh.Hwh) -> None:
    """Raise BuildError if a DMA engine is not at its planned address, so that the files are from another build."""
    found = {design.modules[w.instance].name: w.base for w in hwh.windows(design) if w.instance in design.modules}
    wrong = [
        f"dma_{engine.name} is at {found[f'dma_{engine.name}']:#x}, planned at {engine.window.base:#x}"
        for engine in system.engines
        if found.get(f"dma_{engine.name}", engine.window.base) != engine.window.base
    ]
    if wrong:
        raise BuildError("the .hwh is not of this build schema: " + "; ".join(wrong))


def _loadable(collected: Collected) -> Collected:
    """Check that the CM will load the schema. Raises SchemaError if not."""
    text = collected.files[f"{collected.config.name}.yaml"].decode()
    return replace(collected, config=loads(text, f"{collected.config.name}.yaml"))


def write(collected: Collected, out: Path) -> tuple[Path, Path]:
    """Write the folder, and an archive beside it, below `out`; return both paths."""
    name = collected.config.name
    write_folder(out / name, collected.files)
    packed = out / f"{name}.tar.gz"
    packed.write_bytes(archive(name, collected.files))
    return out / name, packed
