# SPDX-License-Identifier: Apache-2.0
"""Verification: does a bitstream fit its purpose?"""

from __future__ import annotations

from collections.abc import Iterator

from cm.formats.bitstream.container import NO_USER_ID
from cm.formats.bitstream.errors import (
    Encrypted,
    FootprintOutside,
    NotFull,
    NotPartial,
    Sha256Mismatch,
    UnknownDevice,
    WrongDevice,
    WrongStatic,
    errors_by_code,
)
from cm.formats.bitstream.footprint import describe, outside
from cm.formats.bitstream.idcodes import DEVICES, REVISION_MASK, base_name, device_by_name, package_of
from cm.formats.bitstream.inspection_report import Refusal, Report
from cm.frozen import dataclass
from cm.schema.model import Config, FrameRange, Module
from cm.schema.problems import did_you_mean

_SHOWN = 4  # footprint entries named in a sentence


@dataclass(frozen=True, slots=True)
class Expectation:
    """What a bitstream is meant for; what is None or empty is not checked.

    `device`: a device or part name, ``xc7z020`` or ``xck26-sfvc784-2LV-c``; a package that it names
    must be that of the header. `idcode`: the word in the bitstream, any revision.
    `footprint`: the frames of the region, stated or learned.
    `user_id`: USERID of the static design; compared where both have one.
    """

    device: str | None = None
    idcode: int | None = None
    partial: bool | None = None
    footprint: tuple[FrameRange, ...] = ()
    user_id: int | None = None
    allow_encrypted: bool = False
    sha256: str | None = None


def _sha256(report: Report, expect: Expectation) -> Iterator[Refusal]:
    if expect.sha256 is not None and report.sha256 != expect.sha256.lower():
        yield Refusal.of(Sha256Mismatch, f"the file has sha256 {report.sha256}, recorded is {expect.sha256.lower()}")


def _expected_idcode(expect: Expectation) -> int | None:
    if expect.idcode is not None:
        return expect.idcode
    known = device_by_name(expect.device) if expect.device else None
    return known.idcode if known else None


def _not_known(expect: Expectation) -> str:
    """What may be wrong with a device's name that says nothing to us; empty if it does, or an IDCODE says more."""
    if expect.idcode is not None or expect.device is None or device_by_name(expect.device) is not None:
        return ""
    hint = did_you_mean(base_name(expect.device), [device.name for device in DEVICES])
    return f", whose IDCODE is not known ({hint})"


def _device(report: Report, expect: Expectation) -> Iterator[Refusal]:
    wanted = expect.device or (f"IDCODE {expect.idcode:08X}" if expect.idcode is not None else None)
    if wanted is None:
        return
    found = f"{report.device or 'an unknown device'}" + (f" (IDCODE {report.idcode:08X})" if report.idcode else "")
    idcode = _expected_idcode(expect)
    if idcode is not None and report.idcode is not None:
        if (idcode ^ report.idcode) & REVISION_MASK:
            yield Refusal.of(WrongDevice, f"built for {found}, meant for {wanted} (IDCODE {idcode:08X})")
    elif expect.device and report.device:
        if base_name(expect.device) != report.device:
            yield Refusal.of(WrongDevice, f"built for {found}, meant for {wanted}{_not_known(expect)}")
    elif not (report.encrypted and expect.allow_encrypted):  # it may hide its IDCODE; who permits that, knows
        yield Refusal.of(UnknownDevice, f"cannot tell whether {found} is {wanted}: give the device's IDCODE, or a .bit")


def _package(report: Report, expect: Expectation) -> Iterator[Refusal]:
    wanted = package_of(expect.device) if expect.device else None
    found = package_of(report.part) if report.part else None
    if wanted and found and wanted != found:
        why = f"its header says {report.part}, package {found}; meant for {expect.device}, package {wanted}"
        yield Refusal.of(WrongDevice, why)


def _static(report: Report, expect: Expectation) -> Iterator[Refusal]:
    if expect.user_id not in (None, NO_USER_ID) and report.user_id is not None and report.user_id != expect.user_id:
        why = f"made with the static design of USERID {report.user_id:08X}, expected {expect.user_id:08X}"
        yield Refusal.of(WrongStatic, why)


def _partial(report: Report, expect: Expectation) -> Iterator[Refusal]:
    if expect.partial is True and not (report.partial and report.looks_partial):
        yield Refusal.of(NotPartial, f"a full bitstream{_evidence(report)}: a region needs a partial one")
    if expect.partial is False and (report.partial or (report.looks_partial and not report.encrypted)):
        yield Refusal.of(NotFull, f"a partial bitstream{_evidence(report)}: the whole device needs a full one")


def _evidence(report: Report) -> str:
    if report.partial == report.looks_partial:
        return ""
    kind = "partial" if report.partial else "full"
    sets = "does not set" if report.looks_partial else "sets"
    return f" (its header says {kind}, but it {sets} WBSTAR and TIMER)"


def _encrypted(report: Report, expect: Expectation) -> Iterator[Refusal]:
    if report.encrypted and not expect.allow_encrypted:
        why = "encrypted, so its frames cannot be checked: set allow_encrypted for the region to permit it"
        yield Refusal.of(Encrypted, why)


def _footprint(report: Report, expect: Expectation) -> Iterator[Refusal]:
    wrong = outside(report, expect.footprint)
    if wrong:
        named = "; ".join(str(item) for item in wrong[:_SHOWN])
        more = f"; and {len(wrong) - _SHOWN} more" if len(wrong) > _SHOWN else ""
        yield Refusal.of(FootprintOutside, f"writes {named}{more}; the region owns {describe(expect.footprint)}")


def refusals(report: Report, expect: Expectation) -> tuple[Refusal, ...]:
    """Return every reason not to load this bitstream for this purpose, the gravest first; empty: load it."""
    return (
        *_sha256(report, expect),
        *report.problems,
        *_device(report, expect),
        *_package(report, expect),
        *_static(report, expect),
        *_partial(report, expect),
        *_encrypted(report, expect),
        *_footprint(report, expect),
    )


def verify(report: Report, expect: Expectation) -> None:
    """Raise the error of the gravest refusal; its message holds the sentences of all."""
    found = refusals(report, expect)
    if found:
        raise errors_by_code()[found[0].code](". ".join(item.message for item in found))


def expect_module(config: Config, module: Module, learned: tuple[FrameRange, ...] = ()) -> Expectation:
    """Return what the runtime schema says of a module's bitstream.

    `learned` is the footprint of another module of the region, for where the schema states none.
    """
    region = config.regions[module.region]
    return Expectation(
        device=config.device,
        idcode=config.idcode,
        partial=True,
        footprint=region.footprint or learned,
        user_id=config.static.user_id if config.static else None,
        allow_encrypted=region.allow_encrypted,
        sha256=module.sha256,
    )


def expect_static(config: Config) -> Expectation:
    """Return what the runtime schema says of the image of a full configuration."""
    return Expectation(
        device=config.device,
        idcode=config.idcode,
        partial=False,
        user_id=config.static.user_id if config.static else None,
        allow_encrypted=config.allow_encrypted,
        sha256=config.sha256,
    )
