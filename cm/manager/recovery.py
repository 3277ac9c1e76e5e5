# SPDX-License-Identifier: Apache-2.0
"""At start: compare what the record says with what the board shows, and keep only what both agree on.

Looks at the boot id, the overlays in configfs, the regions' identity registers and the step that was
under way when the manager died. Touches nothing but leftover overlays of a step that was cut short.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from types import MappingProxyType
from typing import TYPE_CHECKING

from cm.errors import CmError
from cm.frozen import dataclass, replace
from cm.manager.access.register_bus import RegisterBus, is_cut
from cm.manager.errors import NothingToUndo
from cm.manager.execution.worker import Change
from cm.manager.loaders import resolved
from cm.manager.planner import place_of
from cm.manager.state.board_state import (
    BoardState,
    OverlayState,
    RegionEvent,
    RegionPhase,
    RegionState,
    all_lost,
    loading_overlay,
)
from cm.manager.state.journal import ManagerState, Pending, Record
from cm.manager.state.steps import Place, hertz
from cm.schema.model import Config, ConfigType, LoaderKind, Module, Region
from cm.wire.messages.status import place

if TYPE_CHECKING:
    from cm.manager.interfaces import Devices, Files

_CUT_OFF = "it stands decoupled"
_EMPTY = ("power off", "reset")  # states of an fpga_manager whose device holds nothing


@dataclass(frozen=True, slots=True)
class Finding:
    """What is known of the board, what was cut short, and what was found out (sentences)."""

    state: BoardState
    interrupted: Pending | None = None
    notes: tuple[str, ...] = ()


def reconcile(
    record: Record | None, configs: Mapping[str, Config], devices: Devices, registers: RegisterBus, files: Files
) -> Finding:
    """What the board holds, as far as record and board agree. Raises DeviceError where the board cannot be asked."""
    finding = _as_it_reads(_compare(record, configs, devices, registers, files), configs, registers)
    notes = list(finding.notes)
    return replace(finding, state=_adopted(finding.state, configs, devices, notes), notes=tuple(notes))


def _compare(
    record: Record | None, configs: Mapping[str, Config], devices: Devices, registers: RegisterBus, files: Files
) -> Finding:
    if record is None:
        return Finding(BoardState())
    boot_id = devices.boot_id()
    if not boot_id:
        return Finding(BoardState(), None, ("the boot id cannot be read, so the record may be of before a restart",))
    if record.boot_id != boot_id:
        held = f" ({place(record.state.config, record.state.mode)})" if record.state.config else ""
        return Finding(BoardState(), None, (f"the board was restarted; what it held{held} is gone",))
    state = record.state
    notes: list[str] = []
    state = _distrust_pending(state, record.pending)
    state = _overlays(state, record.pending, devices, notes)
    state = _clocks(state, devices, notes)
    state = _port(state, configs, devices, notes)
    if state.static_lost:
        notes.append("a load of a full image did not end well; nothing in the device is accessed")
    else:
        config = configs.get(state.config or "")
        state = _regions(state, config, record.pending, registers, notes)
        if config is not None and config.sha256_source != state.schema:
            state = under_schema(state, config, held_images(config, state, files), notes)
    if record.pending is not None:
        notes.append(
            f"the change to {place(record.pending.config, record.pending.mode)} was cut short at {record.pending.step}"
        )
    return Finding(state, record.pending, tuple(notes))


def _as_it_reads(finding: Finding, configs: Mapping[str, Config], registers: RegisterBus) -> Finding:
    """Registers that nothing has reset since, as they read now: a write that was confirmed is in the hardware at once,
    and in the record within a second.

    Left out are those of regions that the change which was cut short kept from clients, and those that hold what it
    writes itself: they go back to what they were before it. Other values were written since.
    """
    state, cut = finding.state, finding.interrupted
    config = configs.get(state.config or "")
    if config is None or state.mode not in config.modes or state.static_lost:
        return finding
    if cut is not None and state.static_config != cut.from_static:
        return finding
    known = state.values if cut is None else cut.values
    spared = {} if cut is None else _written_by(cut, configs)
    live: dict[str, int] = {}
    for register in config.visible_registers(state.mode).values():
        answers = register.region is None or state.region(register.region).phase is RegionPhase.READY
        if not register.keeps or not answers or (cut and register.region in cut.locked):
            continue
        try:
            value = registers.read(register)
        except (CmError, OSError):
            continue  # what is recorded of it stays
        place = place_of(register)
        if place in spared and spared[place] in (value, None):
            continue
        if value != known.get(register.name, register.reset):
            live[register.name] = value
    if not live:
        return finding
    state = replace(state, values=MappingProxyType({**state.values, **live}))
    return replace(finding, state=state, interrupted=cut and replace(cut, values={**cut.values, **live}))


def _written_by(cut: Pending, configs: Mapping[str, Config]) -> Mapping[Place, int | None]:
    """What the change that was cut short has written where, or would have; None where a load may have reset it."""
    config = configs.get(cut.config)
    if config is None or cut.mode not in config.modes:
        return {}
    same = cut.from_config == cut.config
    visible = config.visible_registers(cut.mode).values()
    set_by_it = (r for r in visible if r.default is not None and not (same and cut.values.get(r.name) == r.default))
    found = ((address, width) for address, width, _ in cut.found)
    stays = config.type is not ConfigType.FULL
    return {**dict.fromkeys(found), **{place_of(r): r.default if stays and not r.region else None for r in set_by_it}}


def _distrust_pending(state: BoardState, pending: Pending | None) -> BoardState:
    """The step that was about to be taken may have been taken: what it touches becomes unknown."""
    if pending is None:
        return state
    if pending.step == "decouple":  # its circuit is unchanged, whether or not it is isolated now
        region = state.region(pending.subject)
        return state.with_region(pending.subject, region.after(RegionEvent.DECOUPLE))
    if pending.step == "repair":  # a frame may have been written half: the region is loaded again
        region = state.region(pending.subject)
        return state.with_region(pending.subject, region.after(RegionEvent.LOSE))
    if pending.step == "registers":
        return state.without_values({pending.subject})
    return state


def _overlays(state: BoardState, pending: Pending | None, devices: Devices, notes: list[str]) -> BoardState:
    overlays = devices.overlays()
    present = set(overlays.list()) if overlays.available() else set()
    kept = tuple(o for o in state.overlays if o.name in present)
    known = {o.name for o in kept}
    for left in (loading_overlay(r) for r in state.regions):
        if left in present and left not in known:
            overlays.remove(left)
            notes.append(f"overlay {left}, left over from a load that was cut short, was removed")
    for gone in (o.name for o in state.overlays if o.name not in present):
        notes.append(f"overlay {gone} is no longer applied")
    if pending is not None and pending.overlay in present and pending.overlay not in known:
        overlays.remove(pending.overlay)
        notes.append(f"overlay {pending.overlay}, left over from the change that was cut short, was removed")
    return replace(state, overlays=kept)


def _clocks(state: BoardState, devices: Devices, notes: list[str]) -> BoardState:
    """Forget clocks that others have set since, or that a change was setting."""
    kept = {}
    for name, rate in state.clocks.items():
        if rate == 0 and not devices.clocks().names():
            kept[name] = rate
            continue
        try:
            there = devices.clocks().find(name).rate
        except (CmError, OSError) as error:
            notes.append(f"clock {name} cannot be read ({error})")
            continue
        if there == rate:
            kept[name] = rate
        else:
            notes.append(f"clock {name} runs at {hertz(there)}, it was set to {hertz(rate)}")
    return replace(state, clocks=MappingProxyType(kept))


def _adopted(state: BoardState, configs: Mapping[str, Config], devices: Devices, notes: list[str]) -> BoardState:
    """Overlays of ours that no record knows, of a run whose record was lost: the next change takes them off."""
    overlays = devices.overlays()
    known = {o.name for o in state.overlays}
    ours: set[str] = set()
    for config in configs.values():
        ours.update(o.name for o in (*config.overlays, *(o for mode in config.modes.values() for o in mode.overlays)))
        ours.update(loading_overlay(name) for name in config.regions)
    for name in overlays.list() if overlays.available() else ():
        if name in ours and name not in known:
            notes.append(f"overlay {name} is applied, but not recorded; the next change removes it")
            state = replace(state, overlays=(*state.overlays, OverlayState(name, "")))
    return state


def _port(state: BoardState, configs: Mapping[str, Config], devices: Devices, notes: list[str]) -> BoardState:
    """An fpga_manager in an error says that its last load went wrong, also one that we did not ask for."""
    by_kernel = (LoaderKind.FPGA_MANAGER, LoaderKind.OVERLAY)
    static = configs.get(state.static_config or "")
    if static is not None and static.loader in by_kernel and (said := port_error(devices, None)):
        notes.append(f"the fpga_manager says {said!r}, so what {static.name} loaded is not trusted")
        return all_lost(state)
    config = configs.get(state.config or "")
    config = resolved(config, (), devices)[0] if config else None
    for name, region in config.regions.items() if config else ():
        if region.loader in by_kernel and name in state.regions and (said := port_error(devices, region.loader_name)):
            notes.append(f"the fpga_manager says {said!r}, so the content of region {name} is not trusted")
            state = state.with_region(name, state.region(name).after(RegionEvent.LOSE))
    return state


def port_error(devices: Devices, name: str | None) -> str:
    """An fpga_manager's state if it is an error, or says that the device is empty; else an empty text."""
    try:
        said = devices.fpga_manager(name).state
    except (CmError, OSError):
        return ""
    return said if "error" in said or said in _EMPTY else ""


def _regions(
    state: BoardState, config: Config | None, pending: Pending | None, registers: RegisterBus, notes: list[str]
) -> BoardState:
    used = _used(config, state.mode) | (pending.held.keys() if pending else set())
    for name, region in state.regions.items():
        if region.phase is RegionPhase.READY:
            checked = _region(name, region, config, registers, notes)
        elif region.phase is RegionPhase.UNKNOWN:
            continue
        elif region.empty and (pending is None or name not in pending.locked):
            checked = _unloaded(name, region, config, registers, notes)
        else:
            checked = _cut_short(name, region, name in used, notes)
        if checked is not region:
            state = state.with_region(name, checked)
    return state


def _unloaded(
    name: str, region: RegionState, config: Config | None, registers: RegisterBus, notes: list[str]
) -> RegionState:
    known = config.regions.get(name) if config else None
    if known is not None and (known.decoupler is None or _cut_off(known, registers) == _CUT_OFF):
        return region
    notes.append(f"region {name} was unloaded, but is not known to be isolated any more")
    return region.after(RegionEvent.LOSE)


def _region(
    name: str, region: RegionState, config: Config | None, registers: RegisterBus, notes: list[str]
) -> RegionState:
    module = config.modules.get(region.module or "") if config else None
    if module is None or config is None or name not in config.regions:
        return region
    wrong = _cut_off(config.regions[name], registers) or _wrong_identity(config, module, registers)
    if wrong is None:
        return region
    notes.append(f"region {name}: {wrong}; its content is not trusted")
    return region.after(RegionEvent.LOSE)


def held_images(config: Config, state: BoardState, files: Files) -> Mapping[str, str]:
    """The sha256 of what the regions hold as a configuration has it, by region, and of its whole image by "".

    Left out is what it has no module, or no good file, of.
    """
    found: dict[str, str] = {}
    for name, region in state.regions.items():
        module = config.modules.get(region.module or "")
        if module is not None and module.region == name:
            with suppress(CmError, OSError):
                found[name] = module.sha256 or files.image(config, module).sha256
    if config.type is ConfigType.FULL:
        with suppress(CmError, OSError):
            found[""] = config.sha256 or files.static_image(config).sha256
    return found


def under_schema(state: BoardState, config: Config, images: Mapping[str, str], notes: list[str]) -> BoardState:
    """What is known of the board once its configuration has another schema, whose `images` are those given.

    That schema says nothing of other builds, so what holds one is not trusted; without what it is made of, the board
    is in no configuration, and no register of it is offered.
    """
    static = config.type is not ConfigType.FULL or state.static_sha256 == images.get("")
    held = state.regions.items()
    other = [n for n, r in held if r.sha256 is not None and not (static and r.sha256 == images.get(n))]
    # Of an unloaded partial configuration only what other regions hold says which build the static part is of.
    shown = state.mode or config.type is ConfigType.FULL or any(r.sha256 for n, r in held if n not in other)
    whole = static and shown and _used(config, state.mode).isdisjoint(other)
    if not static:
        notes.append(f"the device holds another build of {config.name} than its schema names now")
    for name in other:
        region = state.region(name)
        if static:
            notes.append(f"region {name} holds another build of {region.module} than {config.name} names now")
        state = state.with_region(name, region.after(RegionEvent.LOSE))
    if whole:
        return replace(state, schema=config.sha256_source)
    notes.append(f"nothing of it is used until it is loaded: cm load {config.name}")
    return replace(state, config=None, mode=None, values=MappingProxyType({}))


def _used(config: Config | None, mode: str | None) -> set[str]:
    """The regions of a mode."""
    found = config.modes.get(mode or "") if config else None
    return {config.modules[m].region for m in found.modules} if config and found else set()


def _cut_short(name: str, region: RegionState, used: bool, notes: list[str]) -> RegionState:
    """Regions are cut off before a load begins and after it has ended; the record says so in between.

    Those of the mode, and those that were ready, will be coupled again by the change that brings the board back.
    """
    if used and region.phase in (RegionPhase.DECOUPLED, RegionPhase.LOADED) and region.sha256 is not None:
        notes.append(f"region {name} was {region.phase.value}, with {region.module} in it")
        return region
    notes.append(f"region {name} was {region.phase.value}; its content is not trusted")
    return region.after(RegionEvent.LOSE)


def _cut_off(region: Region, registers: RegisterBus) -> str | None:
    decoupler = region.decoupler
    if decoupler is None:
        return None
    try:
        return _CUT_OFF if is_cut(registers, decoupler) else None
    except (CmError, OSError) as error:
        return f"its decoupler cannot be read ({error})"


def _wrong_identity(config: Config, module: Module, registers: RegisterBus) -> str | None:
    identity = config.regions[module.region].identity
    if identity is None or module.identity is None:
        return None
    try:
        value = registers.read_address(identity.base_address + identity.offset, identity.width)
    except (CmError, OSError) as error:
        return f"its identity register cannot be read ({error})"
    if value == module.identity:
        return None
    return f"its identity register reads {value:#x}, {module.name} is {module.identity:#x}"


@dataclass(frozen=True, slots=True)
class Destination:
    """A mode, and the full configuration whose image it needs first."""

    config: Config
    mode: str
    static: str | None = None


def take_stock(
    state: ManagerState, devices: Devices, registers: RegisterBus, files: Files, new_board: bool = False
) -> Finding:
    """Compare record and board, and begin with what both say. Raises DeviceError.

    `new_board`: one that was started since is another one, of which nothing is recorded.
    """
    record, lost = state.read_record()
    other = new_board and record is not None and record.boot_id != devices.boot_id()
    finding = reconcile(None if other else record, state.configs, devices, registers, files)
    if lost:
        finding = replace(finding, notes=(lost, *finding.notes))
    state.adopt(record, finding.state, devices.boot_id())
    return finding


def destination(state: BoardState, interrupted: Pending | None, configs: Mapping[str, Config]) -> Destination | None:
    """The mode that the board is in or was in before the change that was cut short; None if there is none."""
    config = configs.get(state.config or "")
    if config is not None and state.mode is not None and state.mode in config.modes:
        return Destination(config, state.mode)
    if interrupted is not None and config is None:  # cut short after the device was given another image
        return _way_back(interrupted, configs)
    return None


def _way_back(cut: Pending, configs: Mapping[str, Config]) -> Destination | None:
    """The mode that the change came from; None if it needs an image that is not ours to load."""
    config = configs.get(cut.from_config or "")
    if config is None or cut.from_mode is None or cut.from_mode not in config.modes:
        return None
    if config.type is ConfigType.FULL:
        return Destination(config, cut.from_mode)
    return Destination(config, cut.from_mode, cut.from_static) if cut.from_static in configs else None


def is_whole(state: BoardState, there: Destination) -> bool:
    """Whether every region of a mode is ready, and its clocks run as they were set."""
    modules = there.config.modes[there.mode].modules
    clocked = all(name in state.clocks for name in there.config.clocks)
    return clocked and all(state.region(there.config.modules[m].region).phase is RegionPhase.READY for m in modules)


def repair(number: int, there: Destination, cut: Pending | None, board: BoardState) -> Change:
    """The change that brings the board back, with all that the record holds of what was there before."""
    change = Change(number, there.config.name, there.mode, static=there.static, values=board.values, since=board)
    if cut is not None:
        change.resumes = cut
        _restoring(change, there.config, cut, board)
    return change


def _restoring(change: Change, config: Config, cut: Pending, board: BoardState) -> None:
    """Have a change restore what there was before another."""
    change.also = tuple(_lost(config, change.mode, cut, board))
    change.found = {(address, width): value for address, width, value in cut.found}
    change.rates = cut.rates
    if cut.from_config == config.name:
        change.values = {**board.values, **cut.values}


def way_back(name: str, config: str, mode: str, state: ManagerState) -> Destination:
    """Where the last change came from, if it has that name and came from there. Raises NothingToUndo."""
    kept = state.way_back
    if kept is None or kept.name != name:
        raise NothingToUndo(f"the last change on this board is not {name!r}, or its way back was not kept")
    cut = kept.change
    if (cut.from_config, cut.from_mode) != (config, mode):
        came = f"{cut.from_config or 'nothing loaded'}/{cut.from_mode or ''}"
        raise NothingToUndo(f"change {name!r} came from {came}, and does not go back to {config}/{mode}")
    if state.board.static_config == cut.from_static:
        return Destination(state.configs[config], mode)
    there = _way_back(cut, state.configs)
    if there is None:
        raise NothingToUndo(f"change {name!r} came from an image that is gone, and is not the manager's to load")
    return there


def undo(change: Change, there: Destination, state: ManagerState) -> None:
    """Have a change go back as the rollback of the last one would have, had it failed."""
    assert state.way_back is not None
    change.undoing = True
    change.static = there.static
    _restoring(change, there.config, state.way_back.change, state.board)


def _lost(config: Config, mode: str, cut: Pending, board: BoardState) -> Iterator[str]:
    """Modules of regions that the mode leaves alone, but that the change that was cut short did not."""
    named = {config.modules[m].region for m in config.modes[mode].modules}
    for region, name in cut.held.items():
        module = config.modules.get(name)
        if module is None or module.region != region or region in named:
            continue
        now = board.region(region)
        if now.phase is not RegionPhase.READY or now.module != name:
            yield name
