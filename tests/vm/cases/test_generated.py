# SPDX-License-Identifier: Apache-2.0
"""What `cm build generate` makes, as it made it: applied, bound, run by the manager, and taken away again.

The engines behind it are those that the generated Tcl orders (tests/vm/vmboard/hardware.py), under the kernel's own
drivers; interrupts come through the board's interrupt controller.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from axi import Engine
from made import Design, design
from nodes import MAINLINE_HAS_NONE, compatibles, driver_of, drivers, expected
from plsim import nothing
from served import PATIENCE, Manager, until

import cm
from cm import device
from cm.errors import CmError

pytestmark = pytest.mark.needs("xilinx_dma", "overlay", "fpga", "uio_genirq")
NAMES = os.environ.get("CM_VM_DESIGNS", "camera-kv260").split("+")
FIRMWARE = Path("/sys/kernel/debug/cm_axi/firmware")


@pytest.fixture(scope="module", params=NAMES)
def made(request: pytest.FixtureRequest) -> Iterator[Design]:
    with nothing(), design(request.param) as there:
        allow_icap(True)
        yield there


@pytest.fixture
def applied(made: Design) -> Iterator[device.Overlays]:
    """The static part's overlay, by hand."""
    overlays = device.Overlays("/")
    overlays.apply(made.static, made.overlay(made.static))
    until(lambda: drivers(made.overlay(made.static)) == expected(made.overlay(made.static)))
    yield overlays
    for name in reversed(overlays.list()):
        if name != "hardware":
            overlays.remove(name)


@pytest.fixture(scope="module")
def manager(made: Design, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Manager]:
    overlays = device.Overlays("/")
    overlays.apply(made.static, made.overlay(made.static))  # for a window to what is memory here
    made.power_up()
    overlays.remove(made.static)
    served = Manager(tmp_path_factory.mktemp("cm"), made.schema).start()
    yield served
    served.stop()
    for name in reversed(overlays.list()):
        if name != "hardware":
            overlays.remove(name)


def allow_icap(allowed: bool) -> None:
    """Whether a ZynqMP's platform firmware was built with SECURE_ACCESS."""
    if FIRMWARE.exists():
        (FIRMWARE / "secure_access").write_text(str(int(allowed)))


def module_overlays(made: Design) -> list[str]:
    return sorted(path.stem for path in made.folder.glob("*.dtbo") if path.stem.startswith(("module_", "mode_")))


# what is applied


def test_every_node_of_the_static_part_is_bound_but_those_that_mainline_has_no_driver_for(
    made: Design, applied: device.Overlays
) -> None:
    blob = made.overlay(made.static)
    assert drivers(blob) == expected(blob)
    assert {
        "fpga-cm,window",
        "fpga-cm,clocks",
        "fpga-cm,dma-client",
        "fpga-cm,decoupler",
        "fpga-cm,icap-loader",
    } <= set(compatibles(blob).values())
    unbound = [compatible for name, compatible in compatibles(blob).items() if not driver_of(name)]
    assert all(compatible in MAINLINE_HAS_NONE for compatible in unbound)


def test_the_clocks_of_the_design_run_at_the_rate_that_it_asks_for(made: Design, applied: device.Overlays) -> None:
    for name, clock in made.config["clocks"].items():
        rate = int(Path("/sys/class/cm_clock", name, "rate").read_text())
        assert clock["rate"] - clock["rate"] // 50 <= rate <= clock["rate"]


def test_a_design_behind_a_coherent_port_needs_no_cache_maintenance(made: Design, applied: device.Overlays) -> None:
    told = Path("/sys/class/cm_dma/cm_dma!camera/coherent").read_text().strip()
    assert told == str(int(made.folder.name.endswith("-coherent")))


def test_each_modules_overlay_is_bound_and_goes_again(made: Design, applied: device.Overlays) -> None:
    for name in module_overlays(made):
        blob = made.overlay(name)
        applied.apply(name, blob)
        assert drivers(blob) == expected(blob)
        assert compatibles(blob)
        applied.remove(name)
        assert set(drivers(blob).values()) == {"no device"}


def test_nothing_is_left_of_the_static_part_when_its_overlay_goes(made: Design, applied: device.Overlays) -> None:
    blob = made.overlay(made.static)
    for _ in range(2):
        applied.remove(made.static)
        assert set(drivers(blob).values()) == {"no device"}
        assert (device.list_dma(), device.list_icap()) == ([], [])
        applied.apply(made.static, blob)
        until(lambda: drivers(blob) == expected(blob))


# the manager on it


def enter(board: cm.Board, made: Design, mode: str) -> None:
    """Enter a mode; its module tells who it is when it has been loaded."""
    (module,) = made.config["modes"][mode]["modules"]
    Engine("icap").set("identity", made.identity(module))
    board.load(made.config["name"], mode)


def test_the_manager_loads_the_camera_and_frames_come(made: Design, manager: Manager) -> None:
    with manager.connected() as board:
        enter(board, made, "default")
        assert (board.mode, board.status.pr_mode) == ("default", "idle")
        assert Engine("icap").number("loads") > 0
        with board.stream("camera", timeout=PATIENCE) as stream:
            board.configure_stream("camera", enable=True)
            first, second = stream.read(), stream.read()
        assert first.shape == (480, 640)
        words = np.ascontiguousarray(first).view("<u4").ravel()
        assert np.array_equal(words, words[0] + np.arange(len(words), dtype=np.uint32))
        assert second.sequence > first.sequence


def test_modes_change_with_their_overlays_and_registers(made: Design, manager: Manager) -> None:
    with manager.connected() as board:
        enter(board, made, "default")
        assert driver_of(next(iter(compatibles(made.overlay("module_default"))))) == "cm_window"
        board.registers["focus"] = 3
        enter(board, made, "edge_detection")
        assert driver_of(next(iter(compatibles(made.overlay("module_default"))))) == "no device"
        board.registers["threshold"] = 200
        assert board.registers["threshold"] == 200
        assert board.registers["cm_id"] == 0x434D3031


def test_a_module_that_says_it_is_another_one_is_refused(made: Design, manager: Manager) -> None:
    with manager.connected() as board:
        enter(board, made, "default")
        Engine("icap").set("identity", made.identity("default"))
        with pytest.raises(CmError, match="identity"):
            board.load(mode="edge_detection")
