# SPDX-License-Identifier: Apache-2.0
"""Errors of the manager, each with its stable code, and what they say of names that are not known."""

from __future__ import annotations

from collections.abc import Iterable

from cm.errors import Busy, CmError, InvalidRequest, NotFound, Timeout


def hint(name: str, known: Iterable[str]) -> str:
    """The nearest names, or all."""
    import difflib  # only those who err need it

    known = list(known)
    folded = {one.lower(): one for one in known}  # PYNQ's names are in capitals
    close = [folded[one] for one in difflib.get_close_matches(name.lower(), folded, n=2)]
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else f"; there are {listed(known)}"


def listed(names: Iterable[str]) -> str:
    """Names for a sentence."""
    return ", ".join(sorted(names)) or "none"


class UnknownConfig(NotFound):
    """No configuration of that name."""

    code = "unknown_config"


class UnknownMode(NotFound):
    """No mode (or module that exactly one mode consists of) of that name."""

    code = "unknown_mode"


class UnknownRegister(NotFound):
    """No such register, or not in this mode."""

    code = "unknown_register"


class UnknownRegion(NotFound):
    """The loaded configuration has no such region."""

    code = "unknown_region"


class UnknownStream(NotFound):
    """No such stream, or not in this mode."""

    code = "unknown_stream"


class UnknownMemory(NotFound):
    """No such memory, or not in this mode."""

    code = "unknown_memory"


class UnknownInterrupt(NotFound):
    """No such interrupt."""

    code = "unknown_interrupt"


class NothingLoaded(CmError):
    """The request needs a loaded configuration."""

    code = "nothing_loaded"


class NothingToUndo(CmError):
    """The change that is to be undone is not the last one, or its way back was not kept."""

    code = "nothing_to_undo"


class NoSuchPlace(NotFound):
    """No device of the board has the address of a register that a plan needs."""

    code = "device_not_found"


class AccessDenied(InvalidRequest):
    """A write of a read-only register, or a read of a write-only one."""

    code = "access"


class OutOfRange(InvalidRequest):
    """A value outside what the register or field allows."""

    code = "out_of_range"


class RegionBusy(Busy):
    """The region is being reconfigured, or is still decoupled after a failure."""

    code = "region_busy"


class ModuleAbsent(Busy):
    """A window's module is not in its region now."""

    code = "module_absent"


class NoWindow(CmError):
    """Its registers cannot be mapped here; they go on by requests. The sentence says why."""

    code = "no_window"


class ChangeBusy(Busy):
    """Another change runs and the queue is full, or the request did not want to wait."""

    code = "busy"


class HeldBy(Busy):
    """Another client holds a lease on it."""

    code = "held_by"


class Cancelled(CmError):
    """The change was cancelled."""

    code = "cancelled"


class StepFailed(CmError):
    """A step of a change failed; the board went back, or the sentence says what it holds now."""

    code = "step_failed"

    def __init__(self, message: str, code: str) -> None:
        super().__init__(message)
        self.cause_code = code


class StepTimeout(Timeout):
    """A step took longer than its time-out."""

    code = "step_timeout"


class LoadFailed(CmError):
    """The configuration port reported an error."""

    code = "load_failed"


class NoPort(CmError):
    """No port of the board can load the region."""

    code = "no_port"


class NoReadback(CmError):
    """What the region holds cannot be read back here, or not be compared; the sentence says why."""

    code = "no_readback"


class RegionWrong(CmError):
    """The region differs from what was loaded, also after it was loaded again."""

    code = "region_wrong"


class LoadUnsupported(CmError):
    """This kernel cannot load that way."""

    code = "device_unsupported"


class WrongDevice(CmError):
    """The port's device is not the one that the bitstream was built for."""

    code = "wrong_device"


class IdentityMismatch(CmError):
    """The region's identity register does not read what the module's schema says."""

    code = "identity_mismatch"


class VerifyFailed(CmError):
    """A register did not read back what was written."""

    code = "verify_failed"


class BadOverlay(InvalidRequest):
    """A .dtbo that is not a device-tree overlay, or that would load a bitstream other than the one that was checked."""

    code = "bad_overlay"


class ClockRate(CmError):
    """A clock cannot run near enough to the rate that the configuration needs."""

    code = "clock_rate"


class WrongStatic(CmError):
    """The static design in the device is not the one that the modules were made with."""

    code = "wrong_static"  # as of a bitstream whose header says so


class StaticUnknown(CmError):
    """It is not known which static part the device holds, so no partial bitstream may be loaded."""

    code = "static_unknown"


class UndoFailed(CmError):
    """A change failed, and so did the rollback: the regions named stay decoupled."""

    code = "undo_failed"


class StoreCorrupt(CmError):
    """The state record cannot be read; it was set aside."""

    code = "store_corrupt"


class StateInUse(Busy):
    """Another manager keeps its record in this state folder."""

    code = "state_in_use"


class RecordFailed(CmError):
    """The state record could not be written."""

    code = "store"
