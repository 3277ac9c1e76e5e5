# SPDX-License-Identifier: Apache-2.0
"""The command line of QEMU, and one run of it to its end."""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from vmboard import zynq
from vmboard.arch import AMD64, ARMHF, ARMMP, Arch

BUDGET_S = 500.0  # for all tests of a board, times its slowness: the watchdog on the board ends those that hang
SILENCE_S = 30.0  # times its slowness: a kernel that has said nothing by then hangs before its console


@dataclass(frozen=True, slots=True)
class Machine:
    """What to boot and with what."""

    arch: Arch
    image: Path
    root: Path
    payload: Path
    memory_mb: int
    machine: str = ""  # more properties of QEMU's machine
    emulator: tuple[str, ...] = ()  # QEMU's command line, where it is not the machine's own
    initrd: Path | None = None  # None: the kernel has its disk drivers built in
    dtb: Path | None = None  # None: the tree QEMU makes
    kvm: bool = False
    slow: int = 1  # times slower than silicon; see tiers.py
    arguments: tuple[str, ...] = ()  # of the kernel, read by guest/main
    forwards: dict[int, int] = field(default_factory=dict)  # host port → port on the board
    keep: bool = False  # what the board writes to its root disk stays there
    init: str = ""  # first process; empty: that of the small boards
    agent: Path | None = None  # socket of QEMU's guest agent
    cpus: int = 2
    budget_s: float = 0  # for all it does; 0: that of a board's tests


def command(machine: Machine) -> list[str]:
    """The command line up to where its consoles go."""
    return [
        machine.arch.qemu,
        *_board(machine),
        *(
            "-smp",
            str(machine.cpus),
            "-m",
            str(machine.memory_mb),
            "-no-reboot",
            "-display",
            "none",
            "-monitor",
            "none",
        ),
        *("-kernel", str(machine.image), "-append", _append(machine)),
        *(("-initrd", str(machine.initrd)) if machine.initrd else ()),
        *(("-dtb", str(machine.dtb)) if machine.dtb else ()),
        *_disk(machine, machine.payload, "cm-payload"),
        *_disk(machine, machine.root, "cm-root", keep=machine.keep),
        *_network(machine),
        *("-device", _device(machine, "virtio-rng")),
    ]


def _board(machine: Machine) -> list[str]:
    if machine.arch == AMD64:
        accelerator = "kvm" if machine.kvm else "tcg,thread=multi"
        return ["-M", "q35", "-cpu", "host" if machine.kvm else "max", "-accel", accelerator, "-nodefaults"]
    if machine.kvm:
        return ["-M", "virt,gic-version=host", "-cpu", "host", "-accel", "kvm", "-nodefaults"]
    processor = "cortex-a15" if machine.arch == ARMMP else "cortex-a53"
    return [
        "-M",
        ",".join(filter(None, ["virt,gic-version=2", machine.machine])),
        "-cpu",
        processor,
        "-accel",
        "tcg,thread=multi",
        "-nodefaults",
    ]


def _device(machine: Machine, name: str) -> str:
    return f"{name}-pci" if machine.arch == AMD64 else f"{name}-device"


def _disk(machine: Machine, image: Path, serial: str, *, keep: bool = False) -> list[str]:
    # what a disk that stays has taken is in the host's page cache, so that killing QEMU is a power cut; the host's own
    # disk need not be waited for
    lasting = "cache=unsafe" if keep else "snapshot=on,cache=unsafe"
    drive = f"if=none,id={serial},file={image},format=raw,{lasting}"
    return ["-drive", drive, "-device", f"{_device(machine, 'virtio-blk')},drive={serial},serial={serial}"]


def _network(machine: Machine) -> list[str]:
    forwards = [f"hostfwd=tcp:127.0.0.1:{here}-:{there}" for here, there in machine.forwards.items()]
    return [
        *("-netdev", ",".join(["user,id=net", "restrict=on", *forwards])),
        *("-device", f"{_device(machine, 'virtio-net')},netdev=net"),
    ]


def _append(machine: Machine) -> str:
    console = "ttyS0" if machine.arch == AMD64 else "ttyAMA0"
    root = [] if machine.initrd else ["root=/dev/vda", "rw", "init=/usr/sbin/cm-init"]
    more = os.environ.get("CM_VM_APPEND", "").split()
    root += [f"cm.init={machine.init}"] if machine.init else []
    return " ".join([f"console={console}", "panic=-1", "loglevel=6", "printk.time=1", *root, *machine.arguments, *more])


@dataclass(frozen=True, slots=True)
class Finished:
    """How a run ended and where its traces lie."""

    status: int | None  # of QEMU; None where it was ended after its time
    seconds: float
    console: Path
    output: Path
    results: Path


def run(machine: Machine, place: Path, watch: Callable[[str], None]) -> Finished:
    """Boot, hand each line the tests print to `watch`, and wait for the board to switch itself off.

    One whose kernel says nothing is booted once more: where PROVE_RCU is set, Linux 6.1 now and then waits without end
    in its self test of RCU tasks, on a host that gives the emulator little time.
    """
    started = time.monotonic()
    try:
        status = _boot(machine, place, watch, SILENCE_S * machine.slow)
    except TimeoutError:
        watch(f"the kernel has said nothing for {SILENCE_S * machine.slow:.0f} s; the board is booted once more")
        status = _boot(machine, place, watch, None)
    results = place / "results.tar"
    if machine.arch == ARMHF:
        zynq.collect(place, results)
    return Finished(status, time.monotonic() - started, place / "console.log", place / "output.log", results)


def _boot(machine: Machine, place: Path, watch: Callable[[str], None], silence: float | None) -> int | None:
    """The status of QEMU; None where it was ended after its time. Raises TimeoutError after `silence`."""
    console, output = place / "console.log", place / "output.log"
    started = time.monotonic()
    deadline = started + (machine.budget_s or BUDGET_S * machine.slow)
    with (
        (place / "qemu.log").open("wb") as log,
        subprocess.Popen(logged(machine, place), stdin=subprocess.DEVNULL, stdout=log, stderr=log) as process,
    ):
        try:
            for lines in _told(process, output):
                for line in lines:
                    watch(line)
                if time.monotonic() > deadline:
                    return None
                if silence is not None and time.monotonic() > started + silence and not _size(console):
                    raise TimeoutError
            return process.returncode
        finally:
            process.kill()


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def logged(machine: Machine, place: Path) -> list[str]:
    """The whole command line, consoles going to files in a folder."""
    if machine.arch == ARMHF:
        return zynq.command(machine, place)
    ports = _ports(machine, place / "console.log", place / "output.log", place / "results.tar")
    return [*command(machine), *ports]


def _ports(machine: Machine, console: Path, output: Path, results: Path) -> list[str]:
    """The kernel's console, and two ports of their own for what the tests print and for their results."""
    arguments = ["-chardev", f"file,id=console,path={console}", "-serial", "chardev:console"]
    arguments += ["-device", _device(machine, "virtio-serial")]
    for name, path in (("output", output), ("results", results)):
        arguments += ["-chardev", f"file,id={name},path={path}"]
        arguments += ["-device", f"virtserialport,chardev={name},name=cm.{name}"]
    if machine.agent:
        arguments += ["-chardev", f"socket,id=agent,path={machine.agent},server=on,wait=off"]
        arguments += ["-device", "virtserialport,chardev=agent,name=org.qemu.guest_agent.0"]
    return arguments


def _told(process: subprocess.Popen[bytes], output: Path) -> Iterator[list[str]]:
    """New lines of the output, again and again until the process has ended."""
    seen, ended = 0, False
    while not ended:
        ended = process.poll() is not None
        text = output.read_bytes() if output.exists() else b""
        *lines, _rest = text[seen:].split(b"\n")
        seen += sum(len(line) + 1 for line in lines)
        yield [line.decode(errors="replace").rstrip() for line in lines]
        if not ended:
            time.sleep(0.2)


def interact(machine: Machine) -> int:
    """Boot with the console on this terminal; Ctrl-A X ends it."""
    if machine.arch == ARMHF:
        with tempfile.TemporaryDirectory() as place:
            words = zynq.command(machine, Path(place), ("mon:stdio", "null"))
            return subprocess.run(words, check=False).returncode
    arguments = ["-chardev", "stdio,id=console,mux=on,signal=off", "-serial", "chardev:console"]
    return subprocess.run([*command(machine), *arguments], check=False).returncode
