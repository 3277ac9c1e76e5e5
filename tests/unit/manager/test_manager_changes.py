# SPDX-License-Identifier: Apache-2.0
"""Changes of mode that go well, wait, are cancelled or refused: whole images, overlays, the queue, prefetch."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from bitstream_support import bit
from manager_process import until
from manager_schemas import DUO
from manager_support import Rig, rig

from cm.errors import CmError
from cm.formats.bitstream import assemble_module
from cm.manager.errors import ChangeBusy, HeldBy, NothingLoaded, RegionBusy, UnknownConfig
from cm.manager.execution.worker import Change
from cm.manager.inputs import Image
from cm.manager.state.board_state import OverlayState
from cm.manager.state.journal import Pending
from cm.schema import loads
from cm.schema.model import Config, LoaderKind, Module
from cm.server.bitstream_and_overlay_files import BoardFiles
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import ChangeMode, CheckRegion, RegWrite, TakeLease
from cm.wire.messages.status import ChangeInfo, ErrorInfo, Progress, Reply

# IDCODE of the xc7z020, IV, DWC and the words that only the device can read
ENCRYPTED = bit(0x30018001, 0x03727093, 0x30016004, 1, 2, 3, 4, 0x30034001, 4, 9, 9, 9, 9)
BOTH_REGIONS = ("a0", "b0", "a1", "b1")


@pytest.fixture
def made(sim: SimBoard, configs: dict[str, Config], tmp_path: Path) -> Iterator[Rig]:
    with rig(sim.root, tmp_path / "state", *configs.values()) as started:
        yield started
        sim.control.clear()


def at(made: Rig, *places: str) -> None:
    for place in places:
        config, _, mode = place.partition("/")
        made.arm(-1)  # only the last one is recorded
        assert made.go(mode, config=config) is None


def error_of(made: Rig, place: str) -> str:
    config, _, mode = place.partition("/")
    made.arm(-1)
    error = made.go(mode, config=config)
    assert error is not None
    assert made.manager.status().last_error == error
    return str(error.code)


def custom(sim: SimBoard, text: str, folder: Path) -> Config:
    """A schema beside its own files; the rest is found in the board's firmware."""
    folder.mkdir(exist_ok=True)
    (folder / "schema.yaml").write_text(text, encoding="utf-8")
    return loads(text, source=folder / "schema.yaml")


# ---- whole images -------------------------------------------------------------------


def test_from_partial_to_full_and_back_over_both_ports(made: Rig, sim: SimBoard, configs: dict[str, Config]) -> None:
    at(made, "duo/default")
    assert made.manager.state.static_sha256 is None
    at(made, "whole/default")
    whole = made.manager.state
    assert whole.static_config == "whole"
    assert whole.static_sha256 == made.files.static_image(configs["whole"]).sha256
    assert {n: r.phase.value for n, r in whole.regions.items()} == {"prr0": "ready", "prr1": "unknown"}
    assert sim.control.state()["overlays"] == ["whole_base"]
    at(made, "duo/default")
    assert made.manager.state.static_config == "whole"
    at(made, "ported/only", "duo/both", "whole/full")
    state = sim.control.state()
    assert [state["regions"][n]["module"] for n in ("prr0", "prr1")] == ["w0", "w1"]
    assert state["overlays"] == ["whole_base", "whole_extra"]
    assert made.manager.registers.read(("led",)).values[0].value == 7


def test_streams_end_before_the_image_and_begin_after_it(made: Rig) -> None:
    at(made, "duo/default")
    made.data_plane.calls.clear()
    order: list[str] = []
    made.fault.watch = lambda name: order.extend([*(kind for kind, _ in made.data_plane.calls), name])
    at(made, "whole/full")
    assert made.data_plane.calls == [("quiesce", ("through0", "through1")), ("resume", "full")]
    load = order.index("fpga_manager.load")
    assert "quiesce" in order[:load]
    assert "resume" not in order[:load]


def test_no_register_is_read_while_the_whole_device_is_loaded(made: Rig) -> None:
    at(made, "duo/default")
    seen: dict[str, type[Exception]] = {}

    def read(name: str) -> None:
        try:
            made.manager.registers.read(("led",))
        except CmError as error:
            seen[name] = type(error)

    made.fault.watch = lambda name: read(name) if name in ("overlays.remove", "fpga_manager.load") else None
    at(made, "whole/default")
    assert seen == {"overlays.remove": RegionBusy, "fpga_manager.load": NothingLoaded}


def test_pr_mode_says_what_kind_of_change_runs_and_that_it_failed(made: Rig, sim: SimBoard) -> None:
    seen = []
    made.fault.watch = lambda _: seen.append(made.manager.status().pr_mode.value)
    at(made, "duo/default")
    assert set(seen[:-1]) == {"partial"}  # the last one is the record of the end
    seen.clear()
    at(made, "whole/default")
    assert set(seen[:-1]) == {"full"}
    seen.clear()
    assert made.manager.submit(ChangeMode("whole", "default", force=True)).wait(60)
    assert set(seen[:-1]) == {"full"}
    assert made.manager.status().pr_mode.value == "idle"
    seen.clear()
    sim.control.inject("overlay_error", "whole_extra")
    assert error_of(made, "whole/full") == "device_invalid"
    assert set(seen[:-1]) == {"partial"}
    assert made.manager.status().pr_mode.value == "error"


def test_a_lost_static_part_is_not_accessed_and_takes_no_partial_bitstream_also_after_a_restart(
    made: Rig, sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    """What the boot loader had loaded cannot be restored: only a whole image helps."""
    at(made, "duo/default")
    sim.control.inject("fpga_manager_error")
    assert error_of(made, "whole/default") == "undo_failed"
    load = made.fault.names.index("fpga_manager.load")
    assert not [name for name in made.fault.names[load:] if name.startswith(("uio", "icap"))]
    assert made.manager.status().config_name == ""
    assert error_of(made, "duo/default") == "static_unknown"
    assert made.manager.status().last_error == ErrorInfo(
        "static_unknown",
        "the load of a full image failed, so it is unknown what the device holds; duo is partial and needs its static "
        "part: load a full configuration, or restart the board",
    )
    made.close()
    with rig(sim.root, tmp_path / "state", *configs.values()) as again:
        assert any("full image" in note for note in again.notes)
        assert error_of(again, "duo/default") == "static_unknown"
        at(again, "whole/default", "duo/default")


# ---- overlays -----------------------------------------------------------------------


def test_overlays_go_before_their_region_is_cut_off_and_come_after_it_is_loaded(made: Rig, sim: SimBoard) -> None:
    at(made, "kernel/default")
    at(made, "kernel/other")
    steps = [name for name in made.fault.names if name != "journal.write" and name != "uio.read"]
    assert steps[:2] == ["overlays.remove", "overlays.remove"]  # kernel_base, cm-prr0
    assert steps[2:6] == ["uio.write", "overlays.apply", "overlays.apply", "uio.write"]
    assert sim.control.state()["overlays"] == ["cm-prr1", "cm-prr0", "kernel_base"]
    state = made.manager.state
    assert state.overlays[0] == OverlayState("cm-prr1", state.region("prr1").sha256 or "")


def test_a_loading_overlay_that_was_taken_off_is_put_on_again(
    made: Rig, sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    at(made, "kernel/default")
    made.devices.overlays().remove("kernel_base")
    made.devices.overlays().remove("cm-prr1")
    made.close()
    with rig(sim.root, tmp_path / "state", *configs.values()) as again:
        assert any("cm-prr1 is no longer applied" in note for note in again.notes)
        at(again, "kernel/default")
        assert sorted(sim.control.state()["overlays"]) == ["cm-prr0", "cm-prr1", "kernel_base"]


def test_an_overlay_that_another_has_put_on_under_a_name_of_ours_is_replaced(made: Rig, sim: SimBoard) -> None:
    at(made, "duo/default")
    blob = (sim.root / "lib/firmware/cm/duo/duo_extra.dtbo").read_bytes()
    made.devices.overlays().apply("duo_extra", blob)
    at(made, "duo/both")
    assert [name for name in made.fault.names if name.startswith("overlays")] == ["overlays.remove", "overlays.apply"]
    assert sim.control.state()["overlays"] == ["duo_base", "duo_extra"]
    made.devices.overlays().remove("duo_extra")
    at(made, "duo/default")  # though it is not there to be removed
    assert sim.control.state()["overlays"] == ["duo_base"]


def test_overlays_of_a_run_whose_record_was_lost_are_recognised_and_removed(
    made: Rig, sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    at(made, "duo/both")
    made.close()
    (tmp_path / "state" / "journal").write_bytes(b"\nnothing that could be read\n")
    with rig(sim.root, tmp_path / "state", *configs.values()) as again:
        assert "state record" in again.notes[0]
        assert any("duo_extra is applied, but not recorded" in note for note in again.notes)
        at(again, "duo/default")
        assert sim.control.state()["overlays"] == ["duo_base"]


def test_a_damaged_overlay_is_refused_before_anything_is_touched(made: Rig, sim: SimBoard) -> None:
    at(made, "duo/default")
    extra = sim.root / "lib/firmware/cm/duo/duo_extra.dtbo"
    good = extra.read_bytes()
    try:
        extra.write_bytes(good[:-8])
        assert error_of(made, "duo/both") == "bad_overlay"
        extra.write_bytes(b"overlay")
        assert error_of(made, "duo/both") == "bad_overlay"
        assert made.fault.names == ["journal.write"] * len(made.fault.names)
    finally:
        extra.write_bytes(good)
    at(made, "duo/both")


def test_a_loading_overlay_for_another_bitstream_is_refused(made: Rig, sim: SimBoard) -> None:
    """The kernel loads what the overlay names, so that must be what was validated."""
    at(made, "kernel/default")
    folder = sim.root / "lib/firmware/cm/kernel"
    good = (folder / "l0.dtbo").read_bytes()
    try:
        (folder / "l0.dtbo").write_bytes((folder / "k0.dtbo").read_bytes())
        assert error_of(made, "kernel/other") == "bad_overlay"
    finally:
        (folder / "l0.dtbo").write_bytes(good)
    assert sim.control.state()["regions"]["prr0"]["module"] == "k0"


def test_the_kernels_message_about_an_overlay_is_shown(made: Rig, sim: SimBoard) -> None:
    at(made, "duo/default")
    sim.control.inject("overlay_error", "duo_extra")
    error = made.go("both", config="duo")
    assert error is not None
    assert "apply overlay duo_extra" in error.message
    assert "EINVAL" in error.message
    assert "back in duo/default" in error.message
    assert sim.control.state()["overlays"] == ["duo_base"]


# ---- the queue ----------------------------------------------------------------------


@pytest.fixture
def held(made: Rig) -> Iterator[threading.Event]:
    """A change that stops at its first load until the event is set."""
    at(made, "duo/default")
    free, reached = threading.Event(), threading.Event()

    def stop(name: str) -> None:
        if name == "icap.load" and not free.is_set():
            reached.set()
            assert free.wait(60)

    made.fault.watch = stop
    made.manager.submit(ChangeMode(config_name="duo", mode="both"))
    assert reached.wait(60)
    yield free
    free.set()
    made.manager.wait_idle()


def test_a_second_change_waits_for_the_first(made: Rig, held: threading.Event) -> None:
    second = made.manager.submit(ChangeMode(config_name="duo", mode="default"))
    assert not second.wait(0.05)
    held.set()
    assert second.wait(60)
    assert second.error is None
    assert made.manager.status().mode == "default"


def test_a_mode_alone_belongs_to_the_configuration_that_is_being_loaded_first(made: Rig) -> None:
    """As after `cm serve --load` or `--sim`: a client may be there before the first change has ended."""
    held, let = threading.Event(), threading.Event()

    def hold(name: str) -> None:
        held.set()
        assert let.wait(60)

    with pytest.raises(NothingLoaded):
        made.manager.submit(ChangeMode(mode="both"))
    made.fault.watch = hold
    first = made.manager.submit(ChangeMode(config_name="duo", mode="default"))
    assert held.wait(60)
    second, third = (made.manager.submit(change) for change in (ChangeMode(mode="both"), ChangeMode(mode="default")))
    let.set()
    assert all(change.wait(60) and change.error is None for change in (first, second, third))
    assert (second.config, second.mode, third.mode) == ("duo", "both", "default")
    assert made.manager.status().mode == "default"


def test_a_change_that_does_not_want_to_wait_is_refused(made: Rig, held: threading.Event) -> None:
    with pytest.raises(ChangeBusy) as refused:
        made.manager.submit(ChangeMode(config_name="duo", mode="default", no_queue=True))
    assert str(refused.value) == "a change to duo/both is running"
    assert made.manager.changing
    with pytest.raises(ChangeBusy) as refused:
        made.manager.submit(ChangeMode(config_name="duo", mode="default", undo="c1"))
    assert str(refused.value) == "a change runs: only the last one that has ended can be undone"
    held.set()
    made.manager.wait_idle()
    assert made.manager.submit(ChangeMode(config_name="duo", mode="default", no_queue=True)).wait(60)


def test_the_queue_is_bounded(made: Rig, held: threading.Event) -> None:
    waiting = [made.manager.submit(ChangeMode(config_name="duo", mode="default")) for _ in range(8)]
    with pytest.raises(ChangeBusy) as refused:
        made.manager.submit(ChangeMode(config_name="duo", mode="default"))
    assert str(refused.value) == "8 changes wait already; try again when one has ended"
    waiting[3].cancel()
    held.set()
    assert all(change.wait(60) for change in waiting)
    assert [change.error for change in waiting if change is not waiting[3]] == [None] * 7
    assert waiting[3].error == ErrorInfo("cancelled", "the change was cancelled before it began")
    assert waiting[3].reply() == Reply(error=waiting[3].error)
    last = waiting[7]
    assert last.reply() == Reply(ChangeInfo(last.number, done=True, seconds=last.seconds, generation=last.generation))
    assert (last.number, last.generation > 0) == (10, True)
    assert (made.manager.status().last_change, made.manager.changing) == (10, False)


def test_changes_that_wait_are_cancelled_when_the_manager_stops(made: Rig, held: threading.Event) -> None:
    waiting = [made.manager.submit(ChangeMode(config_name="duo", mode="default")) for _ in range(3)]
    stopper = threading.Thread(target=made.manager.stop)
    stopper.start()
    assert not waiting[0].wait(0.05)
    held.set()
    stopper.join(60)
    assert [c.error for c in waiting] == [ErrorInfo("cancelled", "the configuration manager is stopping")] * 3
    assert made.manager.status().mode == "both"


def test_a_configuration_is_not_replaced_while_it_is_changed_to(made: Rig, held: threading.Event) -> None:
    with pytest.raises(ChangeBusy) as refused:
        made.manager.add_config(made.manager.configs["duo"])
    assert str(refused.value) == "configuration 'duo' is being loaded; provision it when the change has ended"
    made.manager.check_replaceable("whole")
    for name in ("duo", "whole"):  # a change that waits may need it
        with pytest.raises(ChangeBusy) as refused:
            made.manager.forget_config(name)
        assert str(refused.value) == f"configuration {name!r} is in use"
    held.set()
    made.manager.wait_idle()
    made.manager.forget_config("whole")
    assert made.manager.status().configs == ("duo", "kernel", "managed", "ported")
    assert made.manager.in_use("duo")
    with pytest.raises(UnknownConfig, match=r"^no configuration 'whole'; there are duo, "):
        made.manager.describe("whole", {})


def test_a_configuration_is_described_as_it_is_loaded(made: Rig, configs: dict[str, Config]) -> None:
    with pytest.raises(NothingLoaded) as refused:
        made.manager.describe("", {})
    assert str(refused.value) == "nothing is loaded: name a configuration"
    at(made, "duo/lit")
    told = made.manager.describe("", {})
    assert told.schema == DUO
    assert (told.name, told.type, told.mode) == ("duo", "partial", "lit")
    assert [(mode.name, mode.modules, mode.overlays) for mode in told.modes][2:] == [
        ("both", ("b0", "b1"), ("duo_base", "duo_extra")),
        ("lit", ("b0", "a1"), ("duo_base",)),
    ]
    assert told.modes[1].registers == ("led", "scratch", "gain", "depth")
    assert [(r.name, r.address, r.default, r.region, r.modes) for r in told.registers] == [
        ("led", 0x1018, None, "", ()),
        ("scratch", 0x1014, None, "", ()),
        ("gain", 0x3010, 1, "prr0", ()),
        ("depth", 0x7010, 2, "prr1", ()),
        ("lamp", 0x101C, None, "", ("default", "lit")),
    ]
    assert [(x.name, x.direction, x.shape) for x in told.streams] == [
        ("through0", "s2mm", (4, 4)),
        ("through1", "s2mm", (4, 4)),
    ]
    assert made.manager.describe("duo", {}) == told
    assert (made.manager.describe("whole", {}).mode, made.manager.describe("whole", {}).type) == ("", "full")
    made.manager.add_config(replace(configs["duo"], source=None))
    assert made.manager.describe("duo", {}) == replace(told, schema="")
    at(made, "duo/other")
    assert [x.name for x in made.manager.describe("", {}).streams] == ["through0", "through1"]  # prr1 keeps its own


def test_a_board_that_is_gone_is_noticed_by_a_change_that_has_nothing_to_do(made: Rig) -> None:
    at(made, "duo/default")
    made.fault.watch = lambda name: made.arm(0) if name == "check" else None
    error = made.go("default", config="duo")
    made.fault.watch = lambda _: None
    assert error == ErrorInfo("device_error", "injected at check")
    at(made, "duo/default")


def test_cancelling_stops_before_the_next_region_and_goes_back(made: Rig, sim: SimBoard) -> None:
    at(made, "duo/default")
    loads: list[str] = []

    def cancel(name: str) -> None:
        if name == "icap.load":
            loads.append(name)
            made.manager.cancel()

    made.fault.watch = cancel
    assert error_of(made, "duo/both") == "cancelled"
    assert len(loads) == 2  # one region forth and back; the other was only cut off
    state = sim.control.state()
    assert {r["module"] for r in state["regions"].values()} == {"a0", "a1"}
    assert made.manager.status().pr_mode.value == "idle"


def test_what_a_client_writes_during_a_change_stays_when_that_is_cancelled(made: Rig) -> None:
    """The client was told that it is written; registers that the change itself wrote are restored."""
    at(made, "duo/default")
    write = made.manager.write_registers
    write((RegWrite("scratch", 1), RegWrite("lamp", 2)))

    loads: list[str] = []

    def cancel(name: str) -> None:
        loads.extend([name] if name == "icap.load" else [])
        if loads == ["icap.load"] and name == "icap.load":
            write((RegWrite("scratch", 3), RegWrite("led", 4)))
            made.manager.cancel()

    made.fault.watch = cancel
    assert error_of(made, "duo/both") == "cancelled"
    values = made.manager.registers.read(("scratch", "led", "lamp"))
    assert [value.value for value in values.values] == [3, 4, 2]


# ---- files --------------------------------------------------------------------------


class CountingFiles(BoardFiles):
    """Records what is read."""

    def __init__(self, root: Path) -> None:
        super().__init__(root)
        self.read: list[str] = []

    def port_bytes(self, image: Image) -> bytes:
        self.read.append(image.path.name)
        return super().port_bytes(image)

    def _read_overlay(self, path: Path) -> bytes:
        self.read.append(path.name)
        return super()._read_overlay(path)


def mapped_buffers() -> int:
    """How many of the simulated board's buffers this process has in its memory."""
    return Path("/proc/self/maps").read_text(encoding="utf-8").count("memfd:cm-sim-buffer")


def test_a_repeated_change_reads_no_file(sim: SimBoard, configs: dict[str, Config], tmp_path: Path) -> None:
    mapped = mapped_buffers()
    with rig(sim.root, tmp_path, configs["duo"], prefetch=64 << 20, files=CountingFiles) as made:
        assert isinstance(made.files, CountingFiles)
        at(made, "duo/both", "duo/default")
        until(lambda: sim.control.state()["buffers"] == len(BOTH_REGIONS))
        until(lambda: mapped_buffers() <= mapped)
        made.files.read.clear()
        at(made, "duo/both", "duo/default", "duo/other")
        assert made.files.read == []
    assert sim.control.state()["buffers"] == 0


def test_the_image_of_a_file_that_was_replaced_does_not_stay(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    with rig(sim.root, tmp_path, configs["duo"], prefetch=64 << 20, files=CountingFiles) as made:
        assert isinstance(made.files, CountingFiles)
        at(made, "duo/default")
        until(lambda: sim.control.state()["buffers"] == len(BOTH_REGIONS))
        place = sim.root / "lib/firmware/cm/duo/a1.bit"
        data, day = place.read_bytes(), b"2024/01/01"
        assert day in data
        place.write_bytes(data.replace(day, b"2031/01/01", 1))
        try:
            made.files.read.clear()
            at(made, "duo/both", "duo/default")
            assert "a1.bit" in made.files.read
            until(lambda: sim.control.state()["buffers"] == len(BOTH_REGIONS))
        finally:
            place.write_bytes(data)


def test_a_plan_touches_nothing(made: Rig) -> None:
    at(made, "duo/default")
    before = made.manager.state
    made.arm(-1)
    plan = made.manager.plan(ChangeMode(config_name="duo", mode="both"))
    assert [step.kind for step in plan.steps if step.bytes] == ["load", "load"]
    assert plan.bytes == sum(step.bytes for step in plan.steps) > 0
    assert plan.seconds > 0
    assert made.fault.names == []
    assert made.manager.state is before
    assert made.manager.plan(ChangeMode(mode="both")) == plan
    assert made.manager.plan(ChangeMode("duo", "default")).bytes == 0
    assert made.manager.plan(ChangeMode("duo", "default", force=True)).bytes > 0


def refused(sim: SimBoard, config: Config, folder: Path, mode: str = "default") -> str:
    """The code with which a mode of `config` is refused; nothing was touched."""
    with rig(sim.root, folder / "state", config) as made:
        made.arm(-1)
        code = error_of(made, f"{config.name}/{mode}")
        assert set(made.fault.names) == {"journal.write"}
        return code


def test_what_is_wrong_with_a_bitstream_is_found_before_anything_is_touched(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    whole = replace(configs["whole"], loader=LoaderKind.OVERLAY)
    assert refused(sim, whole, tmp_path) == "load_failed"
    duo = custom(sim, DUO, tmp_path / "duo")
    folder = tmp_path / "duo"
    wrong = {**duo.modules, "a0": replace(duo.modules["a0"], sha256="0" * 64)}
    assert refused(sim, replace(duo, modules=wrong), tmp_path) == "sha256_mismatch"
    assert refused(sim, replace(duo, device="xc7z010"), tmp_path) == "wrong_device"
    (folder / "a0.bit").write_bytes(assemble_module("a0", device="xc7z010"))
    assert refused(sim, replace(duo, device=None), tmp_path) == "wrong_device"  # the port knows what it is
    (folder / "a0.bit").write_bytes(b"nothing")
    assert refused(sim, duo, tmp_path) == "no_sync"
    (folder / "a0.bit").write_bytes((sim.root / "lib/firmware/cm/whole/whole.bit").read_bytes())
    assert refused(sim, duo, tmp_path) == "not_partial"
    (folder / "a0.bit").unlink()


def test_encrypted_bitstreams_need_permission(sim: SimBoard, tmp_path: Path) -> None:
    duo = custom(sim, DUO, tmp_path / "duo")
    (tmp_path / "duo" / "a0.bit").write_bytes(ENCRYPTED)
    assert refused(sim, duo, tmp_path) == "encrypted"
    allowed = {n: replace(r, allow_encrypted=True) for n, r in duo.regions.items()}
    with rig(sim.root, tmp_path / "allowed", replace(duo, regions=allowed)) as made:
        assert error_of(made, "duo/default") == "device_unsupported"  # the simulated device has no key
        assert "icap.load" in made.fault.names


def test_a_module_made_for_another_region_is_refused_before_anything_is_touched(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    duo = custom(sim, DUO, tmp_path / "duo")
    (tmp_path / "duo" / "b0.bit").write_bytes((sim.root / "lib/firmware/cm/duo/b1.bit").read_bytes())
    with rig(sim.root, tmp_path / "state", duo, configs["whole"]) as made:
        assert error_of(made, "duo/other") == "footprint_outside"
        assert set(made.fault.names) <= {"journal.write"}


def test_a_module_that_says_it_is_another_one_is_not_kept(sim: SimBoard, tmp_path: Path) -> None:
    duo = custom(sim, DUO, tmp_path / "duo")
    wrong = {**duo.modules, "b1": replace(duo.modules["b1"], identity=0x77)}
    with rig(sim.root, tmp_path / "state", replace(duo, modules=wrong)) as made:
        at(made, "duo/default")
        error = made.go("both", config="duo")
        assert error == ErrorInfo(
            "identity_mismatch",
            "check that prr1 holds b1: region prr1 answers 0xb1 at its identity register; module b1 is 0x77; "
            "the board is back in duo/default",
        )
        assert made.manager.status().mode == "default"
        assert {r["module"] for r in sim.control.state()["regions"].values()} == {"a0", "a1"}


# ---- registers ----------------------------------------------------------------------


def test_values_come_back_with_the_mode_before_even_from_another_configuration(made: Rig, sim: SimBoard) -> None:
    at(made, "ported/only", "duo/default")
    made.manager.write_registers((RegWrite("gain", 5), RegWrite("depth", 6), RegWrite("led", 3)))
    sim.control.inject("overlay_error", "whole_extra")
    assert error_of(made, "whole/full") == "device_invalid"
    values = {v.name: v.value for v in made.manager.registers.read(("gain", "depth", "led")).values}
    assert values == {"gain": 5, "depth": 6, "led": 3}


def test_a_value_that_was_never_recorded_comes_back_too(made: Rig, sim: SimBoard, configs: dict[str, Config]) -> None:
    wrong = {**configs["duo"].modules, "b0": replace(configs["duo"].modules["b0"], identity=0x77)}
    made.manager.add_config(replace(configs["duo"], modules=wrong))
    at(made, "duo/default")
    lamp = made.devices.window(0x101C, 32)
    lamp.device.write(lamp.offset, 3, 32, lamp.map)  # as the boot loader may have left it
    seen: list[int] = []
    made.fault.watch = lambda name: (
        seen.append(lamp.device.read(lamp.offset, 32, lamp.map)) if name[:4] == "icap" else None
    )
    assert error_of(made, "duo/lit") == "identity_mismatch"
    assert set(seen) == {3, 5}  # 5 was written, and stayed while the rollback loaded
    assert made.manager.registers.read(("lamp",)).values[0].value == 3


def test_a_value_written_in_one_configuration_does_not_affect_the_next(made: Rig) -> None:
    at(made, "duo/default")
    made.manager.write_registers((RegWrite("scratch", 5),))
    at(made, "whole/default")
    assert dict(made.manager.state.values) == {"led": 7}


def test_a_replaced_configuration_without_the_mode_leaves_the_board_in_none(
    made: Rig, configs: dict[str, Config]
) -> None:
    at(made, "duo/both")
    modes = {name: mode for name, mode in configs["duo"].modes.items() if name != "both"}
    made.manager.add_config(replace(configs["duo"], modes=modes))
    status = made.manager.status()
    assert (status.config_name, status.mode) == ("duo", "")
    assert made.manager.registers.read(("led",)).values
    assert made.manager.describe("", {}).mode == ""
    with pytest.raises(NothingLoaded):
        made.manager.repair(CheckRegion("prr0"))
    with pytest.raises(RegionBusy, match="nothing is loaded that could be compared"):
        made.manager.prepared_check("prr0")
    at(made, "duo/default")
    assert not made.manager.cancel()  # nothing runs


# ---- the worker, and what it expects --------------------------------------------------


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (RuntimeError("a defect"), "internal", "RuntimeError: a defect"),
        (OSError(5, "broken card"), "device_error", "[Errno 5] broken card"),
    ],
)
def test_a_defect_of_ours_in_a_step_brings_the_board_back_and_is_called_one(
    made: Rig, error: Exception, code: str, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    at(made, "duo/default")
    made.fault.make = lambda _: error
    told: list[Any] = []
    monkeypatch.setattr(made.data_plane, "progressed", lambda: told.append(made.manager.status().progress))
    made.fault.watch = lambda name: made.arm(0) if name == "icap.load" and made.fault.at < 0 else None
    assert made.go("both", config="duo") == ErrorInfo(
        code, f"load b0 into prr0 by icap: {text}; the board is back in duo/default"
    )
    assert {progress.change for progress in told} == {2}  # of the way back, too


def test_a_listener_that_fails_at_the_end_of_a_change_does_not_stop_later_changes(made: Rig) -> None:
    def fails(_: Change) -> None:
        raise RuntimeError("a listener's defect")

    made.manager.submit(ChangeMode(config_name="duo", mode="default"), fails)
    made.manager.wait_idle()
    until(lambda: "a listener's defect" in str(made.manager.status().last_error))
    at(made, "duo/both")


def test_memory_that_runs_out_while_images_are_fetched_ahead_stops_no_change(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    class Greedy(BoardFiles):
        def image(self, config: Config, module: Module) -> Image:
            if threading.current_thread() is not threading.main_thread() and made.manager.status().last_change:
                raise MemoryError
            return super().image(config, module)

    with rig(sim.root, tmp_path, configs["duo"], prefetch=64 << 20, files=Greedy) as made:
        at(made, "duo/default")
        error = made.go("both", config="duo")
        assert error is not None
        assert "MemoryError" in error.message
        assert made.go("default", config="duo") is not None  # the thread lives and answers


def test_a_plan_estimates_time_from_earlier_changes_even_after_a_restart(
    made: Rig, sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    def slowly(name: str) -> None:
        """Slow enough that the real time of the board's port does not matter."""
        made.clock.ahead += 2.0 if name.startswith("uio") else 1.0 if name.startswith("overlays") else 0.0

    request = ChangeMode(config_name="duo", mode="both")
    at(made, "duo/default")
    first = made.manager.plan(request).seconds
    made.clock.stand_still()
    made.fault.watch = slowly
    at(made, *("duo/both", "duo/default") * 6)
    made.fault.watch = lambda _: None
    plan = made.manager.plan(request)
    made.fault.watch = slowly
    at(made, "duo/both")
    took = made.manager.status().last_change_seconds
    assert took > 1
    assert first < 0.5 * took  # on a board that was quicker
    assert abs(plan.seconds - took) < 0.25 * took
    at(made, "duo/default")
    made.close()
    with rig(sim.root, tmp_path / "state", *configs.values()) as again:
        assert abs(again.manager.plan(request).seconds - plan.seconds) < 0.25 * took


@pytest.mark.parametrize("beside", ["nothing", "a mode of the module that is called so"])
def test_a_mode_that_was_removed_while_its_change_waited_is_unknown(
    made: Rig, configs: dict[str, Config], beside: str
) -> None:
    """The configuration was provisioned anew without it."""
    at(made, "duo/default")
    duo = configs["duo"]
    anew = replace(duo, modes={n: m for n, m in duo.modes.items() if n != "lit"})
    if beside != "nothing":
        one = next(mode for mode in anew.modes.values() if len(mode.modules) == 1)
        module = replace(duo.modules[one.modules[0]], name="lit")
        modes = {**anew.modes, "other": replace(one, name="other", modules=("lit",))}
        anew = replace(anew, modes=modes, modules={**duo.modules, "lit": module})
    held, let = threading.Event(), threading.Event()

    def hold(name: str) -> None:
        held.set()
        assert let.wait(60)

    made.fault.watch = hold
    first = made.manager.submit(ChangeMode(config_name="kernel", mode="default"))
    assert held.wait(60)
    second = made.manager.submit(ChangeMode(config_name="duo", mode="lit"))
    made.manager.add_config(anew)
    made.fault.watch = lambda _: None
    let.set()
    assert first.wait(60)
    assert second.wait(60)
    assert first.error is None
    assert second.error is not None
    assert second.error.code == "unknown_mode"


@pytest.mark.parametrize(
    "happened", ["the board was restarted while a change runs", "the machine slept while a change ran"]
)
def test_what_happens_to_the_board_during_a_change_waits_for_its_end(made: Rig, happened: str) -> None:
    note = made.manager.board_slept if "slept" in happened else made.manager.board_restarted
    seen: list[str] = []

    def noticed(_: str) -> None:
        try:
            note()
        except ChangeBusy as error:
            seen.append(str(error))

    made.arm(-1)
    made.fault.watch = noticed
    assert made.go("default", config="duo") is None
    made.fault.watch = lambda _: None  # what is recorded at the end is not during a change
    assert f"{happened}; its end is awaited" in seen


# ---- what a change tells and records on its way ------------------------------------------


def test_each_step_is_told_with_how_far_it_is_and_kept(made: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    at(made, "duo/default")
    told: list[Progress] = []

    def listen() -> None:
        progress = made.manager.status().progress
        assert progress is not None
        told.append(progress)

    monkeypatch.setattr(made.data_plane, "progressed", listen)
    made.data_plane.calls.clear()
    plan = made.manager.plan(ChangeMode("duo", "both"))
    at(made, "duo/both")
    assert (told[0].step, made.manager.status().progress) == ("validate", None)
    assert all((one.change, one.target_config, one.target_mode) == (2, "duo", "both") for one in told)
    begun = [one for one in told[1:] if not one.bytes_done]
    assert [(one.step, one.subject, one.bytes_total) for one in begun] == [
        (step.kind, step.subject, step.bytes) for step in plan.steps
    ]
    half = next(step.bytes for step in plan.steps if step.bytes) / plan.bytes
    loads = [index for index, step in enumerate(plan.steps) if step.bytes]
    fractions = [0.0] * (loads[0] + 1) + [pytest.approx(half)] + [1.0] * (len(plan.steps) - loads[1] - 1)
    assert [one.fraction for one in begun] == fractions
    assert made.data_plane.calls == [("quiesce", ("through0", "through1")), ("resume", "both")]
    taken = made.manager.reporter.history.changes()[-1].steps
    assert [(step.kind, step.subject) for step in taken] == [(step.kind, step.subject) for step in plan.steps]
    made.manager.write_registers((RegWrite("gain", 4),))
    told.clear()
    at(made, "duo/both")  # only a register is written
    assert [(one.step, one.fraction) for one in told[1:]] == [
        ("validate", 0.0), ("registers", pytest.approx(1 / 3)), ("publish", pytest.approx(2 / 3))
    ]  # fmt: skip


def test_what_is_to_be_restored_is_on_disk_before_it_is_changed(made: Rig, configs: dict[str, Config]) -> None:
    at(made, "whole/default", "duo/default")
    made.manager.write_registers((RegWrite("scratch", 6),))
    found: list[Pending] = []

    def look(name: str) -> None:
        if name in ("overlays.apply", "icap.load", "uio.write"):
            record = made.journal.read()
            assert record is not None
            assert record.pending is not None
            found.append(record.pending)

    made.fault.watch = look
    at(made, "duo/lit")
    assert {(x.number, x.config, x.mode, x.from_config, x.from_mode, x.from_static) for x in found} == {
        (3, "duo", "lit", "duo", "default", "whole")
    }
    assert all(x.held == {"prr0": "a0", "prr1": "a1"} for x in found)
    assert all(x.values == {"gain": 1, "depth": 2, "scratch": 6} for x in found)
    assert list(dict.fromkeys((x.step, x.subject, x.overlay) for x in found)) == [
        ("decouple", "prr0", None),
        ("load", "prr0", None),
        ("registers", "lamp", None),
        ("recouple", "prr0", None),
        ("registers", "gain", None),
    ]
    assert [x.found for x in found if x.subject == "lamp"] == [((0x101C, 32, 0),)]
    record = made.journal.read()
    assert record is not None
    assert (record.pending, record.number, record.state.values["lamp"]) == (None, 3, 5)
    made.fault.watch = lambda _: None
    assert made.fault.names[-3:] == ["uio.read", "journal.write", "journal.write"]  # the last step, and the end
    at(made, "duo/lit")  # which has nothing to do
    record = made.journal.read()
    assert record is not None
    assert record.number == 4
    made.arm(-1)
    for _ in range(2):
        made.manager.flush()
    assert made.fault.names == ["journal.write"]  # how long the steps took, once


def test_what_was_written_is_told_to_streams_before_anybody_else(made: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    at(made, "duo/default")
    told: list[object] = []
    monkeypatch.setattr(made.data_plane, "wrote", told.append)
    monkeypatch.setattr(made.data_plane, "registers_changed", told.append)
    first = made.manager.write_registers((RegWrite("gain", 4),))
    assert told == [first.generation, first]
    assert made.manager.status().generation == first.generation
    change = made.manager.submit(ChangeMode("duo", "default"))
    assert change.wait(60)
    assert told[2:] == [change.generation] == [first.generation + 1]
    lease = made.manager.leases.request(TakeLease("registers:gain", holder="anna"))
    with pytest.raises(HeldBy):
        made.manager.write_registers((RegWrite("gain", 4),))
    made.manager.write_registers((RegWrite("gain", 4),), lease.id)
    with pytest.raises(HeldBy, match="registers:gain is held by anna"):
        made.manager.submit(ChangeMode("duo", "other"))
    change = made.manager.submit(ChangeMode("duo", "other", lease=lease.id))
    assert (change.wait(60), change.error) == (True, None)
    made.manager.note_error(ErrorInfo("wrong", "it was"))
    status = made.manager.status()
    assert (status.last_error, status.pr_mode.value) == (ErrorInfo("wrong", "it was"), "idle")


def test_names_that_clients_read_by_themselves_are_withdrawn_whenever_they_may_lead_elsewhere(
    made: Rig, configs: dict[str, Config]
) -> None:
    at(made, "duo/default")
    table: Any = SimpleNamespace(withdrawn=0)

    def withdraw() -> None:
        table.withdrawn += 1

    table.withdraw = withdraw
    made.manager.publish_to(table)

    def withdrawn(act: Callable[[], object]) -> int:
        before = table.withdrawn
        act()
        return int(table.withdrawn - before)

    assert withdrawn(lambda: made.manager.write_registers((RegWrite("gain", 4),))) == 0
    assert withdrawn(made.manager.status) == 0
    assert withdrawn(lambda: made.manager.add_config(configs["duo"])) == 1
    assert withdrawn(lambda: made.manager.forget_config("ported")) == 1
    locked: list[int] = []
    made.fault.watch = lambda name: locked.append(table.withdrawn) if name == "uio.write" else None
    before = table.withdrawn
    assert withdrawn(lambda: at(made, "duo/lit")) >= 3  # locked, other regions, another mode, released
    made.fault.watch = lambda _: None
    assert locked[0] > before
    assert withdrawn(made.manager.board_restarted) >= 1


def test_a_configuration_that_is_replaced_while_it_is_loaded_has_its_streams_anew(
    made: Rig, configs: dict[str, Config]
) -> None:
    at(made, "duo/default")
    made.data_plane.calls.clear()
    made.manager.add_config(configs["ported"])  # which has no such mode
    assert (made.data_plane.calls, made.manager.state.mode) == ([], "default")
    made.manager.add_config(configs["duo"])
    assert made.data_plane.calls == [("resume", "default")]
