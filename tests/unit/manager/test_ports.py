# SPDX-License-Identifier: Apache-2.0
"""Loads and readbacks at a port that does what the test says: what it is given, waited for, and refused with."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cm.device import DeviceBusy, DeviceNotFound
from cm.errors import CmError
from cm.manager.errors import LoadFailed, LoadUnsupported, NoPort, StepTimeout, WrongDevice
from cm.manager.execution.region_readback import Reader
from cm.manager.inputs import Image
from cm.manager.loaders import Job, Loaders, resolved
from cm.manager.state.steps import Choice
from cm.schema import loads
from cm.schema.model import LoaderKind

CONFIG = loads("""
config:
  name: lab
  regions:
    free: {loader: auto}
    fixed: {loader: icap}
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
    """An ICAP: `ends` are what its waits give, else that all went well; `busy` is how many looks find it so."""

    def __init__(self) -> None:
        self.info = SimpleNamespace(idcode=0x23727093, denied=False, readable=True, max_length=1 << 20, clock_hz=0)
        self.done: list[Any] = []
        self.buffers: list[Buffer] = []
        self.ends: list[Any] = []
        self.busy, self.holds, self.clock = 0, False, 0.0

    def monotonic(self) -> float:
        return self.clock

    def allocate(self, length: int) -> Buffer:
        return Buffer(self, length)

    def status(self) -> Any:
        self.busy -= 1
        self.clock += 1.0
        return SimpleNamespace(loading=self.busy >= 0, bytes_done=7)

    def load(self, buffer: Buffer, length: int, cookie: int, full: bool, encrypted: bool) -> None:
        self.done.append((bytes(buffer.data[:length]), full, encrypted))
        self.cookie = cookie

    def read(self, buffer: Buffer, request: slice, reply: slice, closing: slice, cookie: int) -> None:
        self.done.append((request, reply, closing))
        self.cookie = cookie

    def wait(self, timeout: float) -> Any:
        end = self.ends.pop(0) if self.ends else {}
        if end == "none yet":
            self.clock += timeout
            raise TimeoutError
        return SimpleNamespace(**{"cookie": self.cookie, "status": 0, "length": 8, "reason": "", **end})


class Kernel:
    """An fpga_manager."""

    name, state, can_load = "fpga1", "operating", True

    def __init__(self) -> None:
        self.loaded: list[Any] = []

    def load(self, firmware: str, partial: bool, encrypted: bool) -> None:
        self.loaded.append((firmware, partial, encrypted))


class Bench:
    """Loaders on a board of both ports, and files that are their names."""

    def __init__(self, budget: int = 2 * PAGE) -> None:
        self.port, self.kernel = Port(), Kernel()
        self.read: list[str] = []
        self.ports: dict[str | None, Any] = {None: self.port, "fpga1": self.kernel}
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
        if self.ports.get(None) is None:
            raise DeviceNotFound(2, "no ICAP")
        return self.ports[None]

    def _manager(self, name: str | None) -> Any:
        if self.ports.get(name or "fpga1") is None:
            raise DeviceNotFound(2, f"no {name or 'fpga0'}")
        return self.ports[name or "fpga1"]

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
    monkeypatch.setattr("time.sleep", lambda _: None)
    return Bench()


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
    chosen = CONFIG.modules[module]
    region = CONFIG.regions[chosen.region]
    return Job(CONFIG, image(f"{module}.bit", **more), region, chosen, port=region.loader_name)


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
    assert bench.load(Job(CONFIG, image("b.bit"))) == []
    assert bench.port.done[4:] == [(b"b.bit", True, False)]
    assert (bench.read, len(bench.port.buffers)) == (["b.bit"], 1)


@pytest.mark.parametrize(
    ("arrange", "error", "text"),
    [
        ({"ends": [{"status": 3, "reason": "a CRC"}]}, LoadFailed, "b.bit: the configuration port reported a CRC"),
        ({"ends": ["none yet"] * 99}, StepTimeout, "the port took b.bit for more than 5.0 s and did not finish"),
        ({"busy": 99}, StepTimeout, "the port was busy with an earlier load for 5.0 s; b.bit waits"),
    ],
)  # fmt: skip
def test_a_load_that_does_not_end_well_says_how(
    bench: Bench, arrange: dict[str, Any], error: type[CmError], text: str
) -> None:
    vars(bench.port).update(arrange)
    assert refused(lambda: bench.load(job())) == (error, text)
    assert bench.port.clock == pytest.approx(1.0 if error is LoadFailed else 6.0, abs=2.0)
    vars(bench.port).update(ends=[{"status": 3, "reason": "why"}], busy=0)
    words = b"some"
    write: Any = lambda: bench.loaders.write(CONFIG.regions["fixed"], words, image("b.bit"), 5.0)  # noqa: E731
    assert refused(write) == (LoadFailed, "b.bit: the configuration port reported why")
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
    bench.ports[None] = other = Port()
    other.info.idcode = 0
    check(job(idcode=0x03728093))
    bench.ports[None] = other = Port()
    other.info.denied = True
    assert refused(lambda: check(job())) == (
        LoadFailed,
        "b.bit: the platform's firmware does not let the ICAP be selected; build it with SECURE_ACCESS, or write "
        "loader: auto or fpga_manager",
    )


def test_buffers_keep_to_their_budget_and_the_oldest_go_first(bench: Bench) -> None:
    a, b, c = (Job(CONFIG, image(name), CONFIG.regions["fixed"]) for name in ("a", "b", "c"))
    for each in (a, b, a, c, a, b):
        bench.load(each)
    assert bench.read == ["a", "b", "c", "b"]
    bench.loaders.prefetch([a, b, c])  # only what fits beside the others
    assert bench.read == ["a", "b", "c", "b"]
    bench.loaders.prefetch([c], lambda: False)
    assert (bench.read, len(bench.port.buffers)) == (["a", "b", "c", "b"], 0)
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
    bench.files.image = None  # would be an error
    assert len(bench.port.buffers) == 2


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
    assert refused(lambda: overlay.check(Job(CONFIG, image("all.bit")))) == (
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
    kinds = [region.loader.value for region in config.regions.values()]
    assert kinds == ["icap", "icap", "fpga_manager", "overlay", "icap"]
    bench.ports["fpga2"] = Kernel()
    assert resolved(CONFIG, (), bench.devices)[1]["second"] == Choice(
        LoaderKind.FPGA_MANAGER, "icap: the schema names fpga2"
    )
    bench.port.info.denied = True
    denied = "icap: the platform's firmware does not let it be selected"
    assert resolved(CONFIG, (), bench.devices)[1]["free"] == Choice(LoaderKind.FPGA_MANAGER, denied)
    bench.ports[None] = None
    assert resolved(CONFIG, (), bench.devices)[1]["free"] == Choice(LoaderKind.FPGA_MANAGER, f"icap: {NO_ICAP}")
    bench.kernel.can_load = False
    assert refused(lambda: resolved(CONFIG, ("free",), bench.devices)) == (
        NoPort,
        f"region free (loader: auto) cannot be loaded. icap: {NO_ICAP}; fpga_manager: {NO_FILE}. Mainline kernels load "
        "by overlays with firmware-name: loader: overlay",
    )
    plain = loads("config: {name: plain, modes: {one: {}}}\n")
    assert resolved(plain, (), bench.devices) == (plain, {})


def test_a_refused_load_goes_by_the_other_port_where_that_is_left_open_and_can(bench: Bench) -> None:
    config, _ = resolved(CONFIG, (), bench.devices)
    no = DeviceBusy(16, "it is busy")

    def instead(region: str | None) -> Any:
        return bench.loaders.instead(
            Job(config, image("a.bit"), config.regions[region] if region else None), CONFIG, no
        )

    loader, choice = instead("free")
    assert loader is bench.loaders.kind(LoaderKind.FPGA_MANAGER)
    assert choice == Choice(LoaderKind.FPGA_MANAGER, "icap: it is busy")
    bench.files.firmware_name = lambda _: fails()

    def fails() -> str:
        raise LoadFailed("not where the kernel looks")

    assert refused(lambda: instead("free")) == (LoadFailed, "not where the kernel looks")
    bench.kernel.can_load = False
    for region in ("free", "fixed", "kernel", None):
        assert refused(lambda region=region: instead(region)) == (DeviceBusy, "it is busy")


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
    assert (reader.rest(), list(reader.rest())) == ([3, 8], [])
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
