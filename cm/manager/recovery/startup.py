# SPDX-License-Identifier: Apache-2.0
"""At start: what the board holds, and where to take it if it is in no whole mode."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from cm.manager.access.register_bus import RegisterBus
from cm.manager.errors import NothingToUndo
from cm.manager.execution.worker import Change
from cm.manager.interfaces import Devices
from cm.manager.recovery.reconcile import Finding, reconcile
from cm.manager.state.board_state import ManagerState
from cm.manager.state.record import Pending
from cm.manager.state.table import BoardState, RegionPhase
from cm.schema.model import Config, ConfigType


@dataclass(frozen=True, slots=True)
class Destination:
    """A mode, and the full configuration whose image it needs first."""

    config: Config
    mode: str
    static: str | None = None


def take_stock(state: ManagerState, devices: Devices, registers: RegisterBus) -> Finding:
    """Compare record and board, and begin with what both say. Raises DeviceError."""
    record, lost = state.read_record()
    finding = reconcile(record, state.configs, devices, registers)
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
    change = Change(number, there.config.name, there.mode, static=there.static, values=board.values)
    if cut is not None:
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
