# SPDX-License-Identifier: Apache-2.0
"""Loads and readbacks at a port that does what the test says: what it is given, waited for, and refused with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cm.device import DeviceBusy, DeviceNotFound
from cm.errors import CmError
from cm.manager.errors import LoadFailed, LoadUnsupported, NoPort, RegionBusy, StepTimeout, WrongDevice
from cm.manager.execution.region_readback import Checked, Reader, Scan
from cm.manager.inputs import Image
from cm.manager.loaders import Job, Loaders, resolved
from cm.manager.state.board_state import BoardState, RegionPhase, RegionState
from cm.manager.state.steps import Choice
from cm.schema import loads
from cm.schema.model import LoaderKind
from cm.wire.messages.status import FrameError, RegionCheck

CONFIG = loads("""
config:
  name: lab
  regions:
    free: {loader: auto, loader_name: icap0}
    fixed: {loader: icap, loader_name: icap1}
    kernel: {loader: fpga_manager, loader_name: fpga1}
    bridge: {loader: overlay}
    second: {loader: auto, loader_name: fpga2}
  modules:
    a: {region: free}
    b: {region: fixed}
    c: {region: kernel}
    d: {region: bridge}
  modes: {default: {modules: [a, b, c, d]}}
""")
PAGE = 4096


class Buffer:
    def __init__(self, port: Port, length: int) -> None:
        self.port, self.length, self.data = port, -(-length // PAGE) * PAGE, bytearray(length)
        port.buffers.append(self)

    def memoryview(self) -> memoryview:
        return memoryview(self.data)

    def sync_begin(self, write: bool) -> None:
        self.port.done.append({True: "begin write", False: "begin read"}[write])

    def sync_end(self, write: bool) -> None:
        self.port.done.append({True: "end write", False: "end read"}[write])

    def unmap(self) -> None:
        self.port.done.append("unmap")

    def close(self) -> None:
        if self.port.holds:
            raise DeviceBusy(16, "the port has it")
        self.port.buffers.remove(self)


class Port:
    """An ICAP: `ends` are what its waits give, else that all went well; `busy` is how many looks find it so.

    Its clock is that of the loaders: it goes on while they wait.
    """

    def __init__(self) -> None:
        self.info = SimpleNamespace(idcode=0x23727093, denied=False, readable=True, max_length=1 << 20, clock_hz=0)
        self.done: list[Any] = []
        self.buffers, self.filled = list[Buffer](), list[Buffer]()  # all, and those that reads filled
        self.ends: list[Any] = []
        self.busy, self.holds, self.clock = 0, False, 0.0

    def monotonic(self) -> float:
        return self.clock

    def sleep(self, seconds: float) -> None:
        self.clock = round(self.clock + seconds, 6)

    def allocate(self, length: int) -> Buffer:
        return Buffer(self, length)

    def status(self) -> Any:
        self.busy -= 1
        return SimpleNamespace(loading=self.busy >= 0, bytes_done=7)

    def load(self, buffer: Buffer, length: int, cookie: int, full: bool, encrypted: bool) -> None:
        self.done.append((bytes(buffer.data[:length]), full, encrypted))
        self.cookie = cookie

    def read(self, buffer: Buffer, request: slice, reply: slice, closing: slice, cookie: int) -> None:
        self.done.append((request, reply, closing))
        self.filled.append(buffer)
        self.cookie = cookie

    def wait(self, timeout: float) -> Any:
        end = self.ends.pop(0) if self.ends else {}
        if end == "none yet":
            self.sleep(timeout)
            raise TimeoutError
        return SimpleNamespace(**{"cookie": self.cookie, "status": 0, "length": 8, "reason": "", **end})


class Kernel:
    """An fpga_manager."""

    state, can_load = "operating", True

    def __init__(self, name: str) -> None:
        self.name = name
        self.loaded: list[Any] = []

    def load(self, firmware: str, partial: bool, encrypted: bool) -> None:
        self.loaded.append((firmware, partial, encrypted))


class Bench:
    """Loaders on a board of one ICAP with two names and two fpga_managers, and files that are their names."""

    def __init__(self, budget: int = 2 * PAGE) -> None:
        self.port, self.first, self.kernel = Port(), Kernel("fpga0"), Kernel("fpga1")
        self.read: list[str] = []
        self.ports: dict[str | None, Any] = {
            "icap0": self.port, "icap1": self.port, "fpga0": self.first, "fpga1": self.kernel
        }  # fmt: skip
        self.files: Any = SimpleNamespace(
            port_bytes=lambda image: self.read.append(image.path.name) or image.path.name.encode(),
            firmware_name=lambda image: f"cm/{image.path.name}",
            check_firmware=lambda name, image: None,
            image=lambda config, module: image(f"{module.name}.bit"),
        )
        self.devices: Any = SimpleNamespace(icap=self._icap, fpga_manager=self._manager)
        self.time: Any = self.port
        self.loaders = Loaders(self.devices, self.files, self.time, budget)

    def _icap(self, name: str | None) -> Any:
        return self._port(name, "no ICAP")

    def _manager(self, name: str | None) -> Any:
        return self._port(name or "fpga0", f"no {name}")

    def _port(self, name: str | None, missing: str) -> Any:
        if self.ports.get(name) is None:
            raise DeviceNotFound(2, missing)
        return self.ports[name]

    def load(self, made: Job, timeout: float = 5.0) -> list[int]:
        """Load; what was told of its progress."""
        told: list[int] = []
        region = made.region
        kind = LoaderKind.ICAP if region is None or region.loader is LoaderKind.AUTO else region.loader
        with self.loaders.kind(kind).prepared(made, timeout) as start:
            start(told.append)
        return told


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    made = Bench()
    monkeypatch.setattr("time.sleep", made.port.sleep)
    return made


USUAL = {"length": 6, "idcode": 0x03727093, "partial": True, "encrypted": False}


def image(name: str, **more: Any) -> Image:
    return Image(
        Path(name),
        **{
            "sha256": name,
            "length": 6,
            "idcode": 0x03727093,
            "partial": True,
            **more,
            "encrypted": more.get("encrypted", False),
        },
    )


def job(module: str = "b", **more: Any) -> Job:
    region = CONFIG.regions[CONFIG.modules[module].region]
    return Job(image(f"{module}.bit", **more), region, port=region.loader_name)


def refused(call: Callable[[], object]) -> tuple[type[Exception], str]:
    with pytest.raises(CmError) as caught:
        call()
    return caught.type, str(caught.value)


# ---- the ICAP ---------------------------------------------------------------------------


def test_an_image_is_written_once_and_its_own_end_is_waited_for(bench: Bench) -> None:
    bench.port.busy = 2
    bench.port.ends = ["none yet", {"cookie": 99, "status": 5}]  # an earlier load's
    assert bench.load(job(encrypted=True)) == [7]
    assert bench.port.done == ["begin write", "end write", "unmap", (b"b.bit", False, True)]
    assert bench.load(Job(image("b.bit"), port="icap1")) == []
    assert bench.port.done[4:] == [(b"b.bit", True, False)]
    assert (bench.read, len(bench.port.buffers)) == (["b.bit"], 1)
    exactly = Bench(budget=PAGE)
    assert (exactly.load(job()), exactly.load(job()), exactly.read) == ([], [], ["b.bit"])


@pytest.mark.parametrize(
    ("arrange", "error", "text"),
    [
        ({"ends": [{"status": 3, "reason": "a CRC"}]}, LoadFailed, "b.bit: the configuration port reported: a CRC"),
        ({"ends": ["none yet"] * 99}, StepTimeout, "the port took b.bit for more than 5.0 s and did not finish"),
        ({"busy": 99}, StepTimeout, "the port was busy with an earlier load for 5.0 s; b.bit waits"),
    ],
)  # fmt: skip
def test_a_load_that_does_not_end_well_says_how(
    bench: Bench, arrange: dict[str, Any], error: type[CmError], text: str
) -> None:
    vars(bench.port).update(arrange)
    assert refused(lambda: bench.load(job())) == (error, text)
    assert bench.port.clock == (0.0 if error is LoadFailed else 5.0)
    vars(bench.port).update(ends=[{"status": 3, "reason": "why"}], busy=0)
    words = b"some"
    write: Any = lambda: bench.loaders.write(CONFIG.regions["fixed"], words, image("b.bit"), 5.0)  # noqa: E731
    assert refused(write) == (LoadFailed, "b.bit: the configuration port reported: why")
    write()
    assert (bench.port.done[-1], len(bench.port.buffers)) == ((b"some", False, False), 1)


def test_the_port_refuses_images_of_other_devices_and_is_asked_once(bench: Bench) -> None:
    check = bench.loaders.kind(LoaderKind.ICAP).check
    for idcode in (0x03727093, 0xF3727093, None):  # whatever the revision
        check(job(idcode=idcode))
    assert refused(lambda: check(job(idcode=0x03728093))) == (
        WrongDevice,
        "b.bit: made for IDCODE 0x03728093, but the port is that of 0x23727093",
    )
    bench.port.info = SimpleNamespace(idcode=0, denied=True)
    check(job())
    bench.ports["icap1"] = other = Port()
    other.info.idcode = 0
    check(job(idcode=0x03728093))
    bench.ports["icap1"] = other = Port()
    other.info.denied = True
    assert refused(lambda: check(job())) == (
        LoadFailed,
        "b.bit: the platform's firmware does not let the ICAP be selected; allow 0xFFCA3008 in its "
        "pm_mmio_access.c, or write loader: auto or fpga_manager",
    )


def test_buffers_keep_to_their_budget_and_the_oldest_go_first(bench: Bench) -> None:
    a, b, c = (Job(image(name), CONFIG.regions["fixed"], port="icap1") for name in ("a", "b", "c"))
    long = replace(a, image=image("long", length=PAGE + 1))
    for each in (a, b, a, c, a, b):
        bench.load(each)
    assert bench.read == ["a", "b", "c", "b"]
    bench.loaders.prefetch([a, b, c])  # only what fits beside the others
    assert bench.read == ["a", "b", "c", "b"]
    bench.loaders.prefetch([c], lambda: False)
    assert (bench.read, len(bench.port.buffers)) == (["a", "b", "c", "b"], 0)
    bench.loaders.prefetch([b, long])
    bench.loaders.prefetch([b, c])
    bench.loaders.forget()
    assert (bench.read[4:], bench.port.buffers) == (["b", "c"], [])


def test_what_a_hung_load_still_holds_is_given_back_later() -> None:
    bench = Bench(budget=0)
    bench.port.holds = True
    bench.load(job())
    bench.port.holds = False
    assert len(bench.port.buffers) == 1
    bench.loaders.prefetch([job()])  # nothing has room
    assert bench.read == ["b.bit"]
    bench.load(job())
    assert bench.port.buffers == []


def test_memory_that_cannot_be_filled_is_given_back(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(_: Buffer) -> None:
        raise DeviceBusy(16, "no")

    monkeypatch.setattr(Buffer, "unmap", fails)
    assert refused(lambda: bench.load(job())) == (DeviceBusy, "no")
    assert bench.port.buffers == []


def test_images_of_a_configuration_are_fetched_once_until_another_is_loaded(bench: Bench) -> None:
    bench.loaders.prefetch_modules(CONFIG, lambda: True)
    assert bench.read == ["a.bit", "b.bit"]  # those that go by the ICAP
    bench.loaders.prefetch_modules(CONFIG, lambda: True)
    bench.loaders.forget()
    assert bench.port.buffers == []
    bench.loaders.prefetch_modules(CONFIG, lambda: False)
    assert len(bench.read) == 2
    bench.loaders.prefetch_modules(CONFIG, lambda: True)
    assert (len(bench.read), len(bench.port.buffers)) == (4, 2)
    bench.loaders.prefetch_modules(None, lambda: True)
    assert len(bench.port.buffers) == 2


@pytest.mark.parametrize("error", [LoadFailed("it has changed"), OSError(5, "broken card")])
def test_what_cannot_be_fetched_ahead_is_left_to_the_load_that_needs_it(bench: Bench, error: Exception) -> None:
    def fails(*_: object) -> Any:
        raise error

    bench.files.image = lambda _, module: image("b.bit") if module.name == "b" else fails()
    bench.loaders.prefetch_modules(CONFIG, lambda: True)
    assert bench.read == ["b.bit"]
    bench.loaders.forget()
    bench.files.port_bytes = fails
    bench.loaders.prefetch_modules(CONFIG, lambda: True)
    assert bench.port.buffers == []
    none = Bench(budget=0)
    none.files.image = fails  # what cannot be kept is not even looked at
    none.loaders.prefetch_modules(CONFIG, lambda: True)


# ---- the kernel's, and overlays --------------------------------------------------------------


def test_the_kernel_is_told_a_name_and_asked_what_came_of_it(bench: Bench) -> None:
    assert bench.load(job("c", length=6)) == [6]
    assert bench.load(job("c", encrypted=True)) == [6]
    assert bench.kernel.loaded == [("cm/c.bit", True, False), ("cm/c.bit", True, True)]
    bench.kernel.state = "write error"
    assert refused(lambda: bench.load(job("c"))) == (
        LoadFailed,
        "c.bit: fpga_manager fpga1 says 'write error' after the load",
    )
    check = bench.loaders.kind(LoaderKind.FPGA_MANAGER).check
    check(job("c"))
    bench.kernel.can_load = False
    assert refused(lambda: check(job("c"))) == (
        LoadUnsupported,
        "c.bit: this kernel's fpga_manager cannot load through sysfs (linux-xlnx can); use loader: overlay with "
        "firmware-name, or loader: icap",
    )


def test_a_whole_image_does_not_go_by_overlay_and_a_leftover_one_is_removed_first(bench: Bench) -> None:
    overlay = bench.loaders.kind(LoaderKind.OVERLAY)
    overlay.check(job("d"))
    assert refused(lambda: overlay.check(Job(image("all.bit")))) == (
        LoadFailed,
        "all.bit: a whole image is loaded by fpga_manager or icap, not by overlay",
    )
    there, done = {"cm-bridge"}, []
    bench.devices.overlays = lambda: SimpleNamespace(
        has=there.__contains__, remove=there.remove, apply=lambda *what: done.append((what, *there))
    )
    assert bench.load(job("d")) == [6]
    assert bench.load(job("d")) == [6]
    assert done == [(("cm-bridge", b""),)] * 2


# ---- which port -----------------------------------------------------------------------------


NO_ICAP, NO_FILE = "no ICAP", "this kernel's fpga_manager has no firmware attribute (linux-xlnx has)"


def test_only_what_the_schema_leaves_open_is_chosen(bench: Bench) -> None:
    config, choices = resolved(CONFIG, ("free",), bench.devices)
    assert choices == {
        "free": Choice(LoaderKind.ICAP, ""),
        "second": Choice(LoaderKind.ICAP, "icap: the schema names fpga2; fpga_manager: no fpga2"),
    }
    ports = [(region.loader.value, region.loader_name) for region in config.regions.values()]
    assert ports == [("icap", "icap0"), ("icap", "icap1"), ("fpga_manager", "fpga1"), ("overlay", None),
                     ("icap", "fpga2")]  # fmt: skip
    bench.ports["fpga2"] = Kernel("fpga2")
    bench.port.info.denied = True
    config, choices = resolved(CONFIG, (), bench.devices)
    denied = "icap: the platform's firmware does not let it be selected"
    assert choices == {
        "free": Choice(LoaderKind.FPGA_MANAGER, denied),
        "second": Choice(LoaderKind.FPGA_MANAGER, "icap: the schema names fpga2"),
    }
    assert [config.regions[name].loader_name for name in choices] == [None, "fpga2"]  # icap0 is none of the kernel's
    bench.ports["icap0"] = None
    assert resolved(CONFIG, (), bench.devices)[1]["free"] == Choice(LoaderKind.FPGA_MANAGER, f"icap: {NO_ICAP}")
    bench.first.can_load = False
    assert refused(lambda: resolved(CONFIG, ("free",), bench.devices)) == (
        NoPort,
        f"region free (loader: auto) cannot be loaded. icap: {NO_ICAP}; fpga_manager: {NO_FILE}. Mainline kernels load "
        "by overlays with firmware-name: loader: overlay",
    )
    plain = loads("config: {name: plain, modes: {one: {}}}\n")
    assert resolved(plain, (), bench.devices) == (plain, {})


def test_a_refused_load_goes_by_the_other_port_where_that_is_left_open_and_can(bench: Bench) -> None:
    bench.ports["fpga2"] = Kernel("fpga2")
    config, _ = resolved(CONFIG, (), bench.devices)
    no = DeviceBusy(16, "it is busy")

    def instead(name: str | None) -> Any:
        region = config.regions[name] if name else None
        made = Job(image("a.bit"), region, port=region.loader_name if region else None)
        return bench.loaders.instead(made, CONFIG, no)

    loader, given, choice = instead("free")
    assert loader is bench.loaders.kind(LoaderKind.FPGA_MANAGER)
    assert choice == Choice(LoaderKind.FPGA_MANAGER, "icap: it is busy")
    with loader.prepared(given, 5.0) as start:  # by the first of the kernel's, whatever the ICAP's name is
        start(lambda _: None)
    assert bench.first.loaded == [("cm/a.bit", True, False)]
    for region in ("fixed", "kernel", "second", None):
        assert refused(lambda region=region: instead(region)) == (DeviceBusy, "it is busy")
    bench.files.firmware_name = lambda _: fails()

    def fails() -> str:
        raise LoadFailed("not where the kernel looks")

    assert refused(lambda: instead("free")) == (LoadFailed, "not where the kernel looks")
    bench.first.can_load = False
    assert refused(lambda: instead("free")) == (DeviceBusy, "it is busy")


# ---- readback -------------------------------------------------------------------------------


def part(request: bytes, wrong: list[int]) -> Any:
    return SimpleNamespace(request=request, reply_length=8, closing=b"end", judge=lambda reply: [*wrong, len(reply)])


def test_slices_are_judged_while_the_next_one_is_read(bench: Bench) -> None:
    reader: Any = Reader(bench.port)  # type: ignore[arg-type]
    bench.port.ends = [{"cookie": 1, "status": 9}]  # an earlier one's
    assert reader.read(part(b"ask", [1])) == ()
    assert bench.port.done == ["begin write", "end write", (slice(0, 3), slice(64, 72), slice(128, 131))]
    assert bench.port.buffers[0].data[:3] + bench.port.buffers[0].data[128:] == b"askend"
    assert reader.read(part(bytes(64), [2])) == [1, 8]
    assert bench.port.done[5:] == [(slice(0, 64), slice(64, 72), slice(128, 131)), "begin read", "end read"]
    first, second = bench.port.buffers
    assert reader.read(part(bytes(PAGE), [3])) == [2, 8]  # needs more room than the first has
    assert first not in bench.port.buffers
    assert second in bench.port.buffers
    both = [*bench.port.buffers]
    assert reader.read(part(b"ask", [4])) == [3, 8]
    assert reader.read(part(bytes(PAGE), [5])) == [4, 8]
    assert (bench.port.buffers, reader.rest(), list(reader.rest())) == (both, [5, 8], [])
    assert all(one is not other for one, other in zip(bench.port.filled, bench.port.filled[1:], strict=False))
    bench.port.holds = True
    reader.close()  # the port has them: they go with it
    assert len(bench.port.buffers) == 2


@pytest.mark.parametrize(
    ("end", "text"),
    [
        ("none yet", "the port did not answer a read within 2 s"),
        ({"length": 4}, "the port gave 4 of 8 bytes: too few"),
        ({"status": 1, "reason": "it hung"}, "the port gave 8 of 8 bytes: it hung"),
    ],
)
def test_a_read_that_brings_nothing_says_so(bench: Bench, end: Any, text: str) -> None:
    bench.port.ends = [end]
    assert refused(lambda: Reader(bench.port).read(part(b"ask", [])))[1] == text  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("clock", "most", "frames"), [(0, 1 << 20, 997), (100_000_000, 1 << 20, 3997), (0, 5000, 47), (0, 100, 1)]
)
def test_a_slice_takes_a_millisecond_of_the_port(bench: Bench, clock: int, most: int, frames: int) -> None:
    bench.port.info = SimpleNamespace(clock_hz=clock, max_length=most)
    assert Reader(bench.port).most_frames(100) == frames  # type: ignore[arg-type]


def scan(board: BoardState, judged: int = 3) -> Scan:
    """Of what was loaded into a region, of which a frame is not compared."""
    frames: Any = SimpleNamespace(judged=judged, unjudged=(1,), why="no mask", frame_bytes=4, slices=lambda _: ())
    region, module = CONFIG.regions["fixed"], CONFIG.modules["b"]
    state, devices = SimpleNamespace(board=board), SimpleNamespace(icap=lambda _: Port())
    what = Checked(CONFIG, "default", region, module, image("b.bit"), frames)
    return Scan(what, state, devices)  # type: ignore[arg-type]


@pytest.mark.parametrize(("phase", "sha256"), [(RegionPhase.READY, "other"), (RegionPhase.DECOUPLED, "b.bit")])
def test_a_region_that_holds_something_else_by_now_ends_its_check_at_once(phase: RegionPhase, sha256: str) -> None:
    begun = scan(BoardState(regions={"fixed": RegionState(phase, "b", sha256)}))
    assert refused(begun.step) == (RegionBusy, "region fixed was changed while it was compared; ask again")


@pytest.mark.parametrize(
    ("judged", "wrong", "verdict", "listed"), [(0, 0, "unjudged", 0), (3, 0, "good", 0), (3, 300, "wrong", 256)]
)
def test_what_was_found_in_a_region_is_counted_whole_and_listed_in_part(
    judged: int, wrong: int, verdict: str, listed: int
) -> None:
    done = scan(BoardState(regions={"fixed": RegionState(RegionPhase.READY, "b", "b.bit")}), judged)
    assert done.step()
    where: Any = SimpleNamespace(block_type=1, row=2, column=3, minor=4)
    done.wrong = [SimpleNamespace(far=far, address=where, bits=tuple(range(65))) for far in range(wrong)]  # type: ignore
    told = done.result(2.5)
    frames = tuple(FrameError(far, 1, 2, 3, 4, tuple(range(64))) for far in range(listed))
    assert told == RegionCheck(
        "fixed", "b", verdict, judged, 1, "no mask", wrong, 65 * wrong, frames, seconds=2.5, config_name="lab",
        mode="default",
    )  # fmt: skip
