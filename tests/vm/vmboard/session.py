# SPDX-License-Identifier: Apache-2.0
"""One invocation: builds the boards, runs them side by side, sums up."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from threading import Lock

from vmboard import initrd, installed, kvm, payload, qemu, record, remote, report, rootfs, service, software, zynq
from vmboard.arch import ARMHF
from vmboard.cache import Cache
from vmboard.errors import EXIT_MISSING, MissingError, VmError
from vmboard.kernel import Kernel
from vmboard.progress import say
from vmboard.shell import require
from vmboard.tiers import TIERS, Tier

PORTS = (5560, 5561, 5562)
_RECORDING = Lock()  # boards end side by side


def worth_while(cache: Cache, everything: bool = False) -> list[str]:
    """All boards but those that this machine cannot have, such as with KVM where it does not work; says which.

    Unless `everything` is wanted, those that were good wait until what they test has changed.
    """
    chosen = []
    for name, tier in TIERS.items():
        if tier.optional:
            say(f"LEFT OUT {name}: it runs where it is asked for, --tier {name}")
        elif not everything and (day := record.waits(tier) and record.unchanged_since(tier)):
            say(f"LEFT OUT {name}: good on {day}, and nothing that it tests has changed since; --tier all runs it")
        elif reason := _out_of_reach(cache, tier):
            say(f"LEFT OUT {name}: {reason}")
        elif tier.kvm and not (kvm.there(tier.arch) and kvm.works(cache, tier.kernel(cache))):
            say(f"LEFT OUT {name}: no working /dev/kvm here; --tier {name} runs it emulated, which tells little new")
        else:
            chosen.append(name)
    return chosen


def _out_of_reach(cache: Cache, tier: Tier) -> str:
    """Why what a board has from another release of Debian cannot be had; empty: it can."""
    try:
        if tier.driver:
            tier.driver.driver(cache)
        if tier.arch == ARMHF:
            zynq.emulator(cache)
    except VmError as error:
        return str(error).splitlines()[0]
    return ""


def build(cache: Cache, names: list[str]) -> None:
    """Everything the named boards need, from the cache or now."""
    make: dict[bool, Callable[[Cache, Tier], object]] = {True: installed.prepared, False: machine}
    with ThreadPoolExecutor(2) as pool:
        for made in [pool.submit(_all, make[kind], cache, tiers) for kind, tiers in _kinds(names).items()]:
            made.result()


def _kinds(names: list[str]) -> dict[bool, list[Tier]]:
    """By whether a Debian is installed on the board, which takes minutes of one core while kernels are compiled."""
    tiers = [TIERS[name] for name in names]
    return {kind: [tier for tier in tiers if tier.installed == kind] for kind in (True, False)}


def _all(make: Callable[[Cache, Tier], object], cache: Cache, tiers: list[Tier]) -> None:
    for tier in tiers:
        make(cache, tier)


def machine(
    cache: Cache, tier: Tier, arguments: tuple[str, ...] = (), forwards: dict[int, int] | None = None
) -> qemu.Machine:
    """Build what a board needs, and describe it."""
    require(
        *([] if tier.arch == ARMHF else [tier.arch.qemu]), "depmod", "mke2fs", "protoc"
    )  # what is missing is told before anything is fetched
    kernel = tier.kernel(cache)
    accelerated = tier.kvm and kvm.works(cache, kernel)
    slow = 1 if accelerated else tier.slow
    if tier.kvm and not accelerated:
        say(f"{tier.name}: no working /dev/kvm here, the board is emulated")
    own = (f"cm.tier={tier.name}", f"cm.expects={','.join(tier.expects)}", f"cm.slow={slow}")
    own += (f"cm.static={tier.static}", f"cm.cases={'+'.join(tier.cases)}")
    own += (f"cm.designs={tier.designs}",)
    own += (f"cm.driver=xilinx_dma{'_other' if tier.driver else ''}",)
    return qemu.Machine(
        arch=tier.arch,
        image=kernel.image,
        root=rootfs.image(cache, tier.arch),
        emulator=tuple(zynq.emulator(cache)) if tier.arch == ARMHF else (),
        payload=payload.image(cache, kernel, tier.driver),
        memory_mb=tier.memory_mb,
        machine=tier.machine,
        initrd=None if tier.fragments else initrd.image(cache, kernel),
        dtb=_tree(cache, tier, kernel),
        kvm=accelerated,
        slow=slow,
        arguments=(*tier.append.split(), *own, *arguments),
        forwards=forwards or {},
    )


def _tree(cache: Cache, tier: Tier, kernel: Kernel) -> Path | None:
    if tier.arch == ARMHF:
        return zynq.tree(cache, kernel)
    return software.overlays(cache) / f"{tier.dtb}.dtb" if tier.fragments else None


def test(cache: Cache, names: list[str], output: Path, jobs: int, keyword: str) -> int:
    """Run the boards and print what they found: 0 where all are good, 1 where one is not, else 77 for a skipped one."""
    with ThreadPoolExecutor(jobs) as boards, ThreadPoolExecutor(2) as makers:
        started = [makers.submit(_start, cache, tiers, keyword, output, boards) for tiers in _kinds(names).values()]
        runs = {name: run for some in started for name, run in some.result().items()}
        if not runs:
            raise MissingError("no board can run here")
    bad = [name for name, run in runs.items() if not _said(name, run, output / name)]
    if bad:
        return 1
    return EXIT_MISSING if len(runs) < len(names) else 0


def _start(
    cache: Cache, tiers: list[Tier], keyword: str, output: Path, boards: Executor
) -> dict[str, Future[report.Results]]:
    """Run each board as soon as it is made, while the next one is being made; says which cannot be had here."""
    runs = {}
    for tier in tiers:
        place = output / tier.name
        try:
            shutil.rmtree(place, ignore_errors=True)
            board = _for_test(cache, tier, keyword, place)
            runs[tier.name] = boards.submit(_recorded, tier.name, board, place, keyword)
        except MissingError as missing:
            say(f"SKIPPED {tier.name}: {missing}")
        except VmError as error:  # the others have something to tell all the same
            runs[tier.name] = Future()
            runs[tier.name].set_exception(error)
    return runs


def _for_test(cache: Cache, tier: Tier, keyword: str, place: Path) -> qemu.Machine:
    if tier.installed:
        require(tier.arch.qemu, "depmod", "mke2fs", "dpkg-deb")
        return service.machine(cache, tier, place, _forwards(tier))
    if not tier.remote:
        changes = int(os.environ.get("CM_VM_CHANGES", tier.changes))  # how many is the user's patience
        words = (f"cm.changes={changes}", *([f"cm.keyword={keyword.replace(' ', '+')}"] if keyword else []))
        return machine(cache, tier, words)
    return machine(cache, tier, ("cm.action=serve",), _forwards(tier))


def _forwards(tier: Tier) -> dict[int, int]:
    first = remote.free_ports(list(TIERS).index(tier.name))
    return {first + index: there for index, there in enumerate(PORTS)}


def _recorded(name: str, board: qemu.Machine, place: Path, keyword: str) -> report.Results:
    """As `_run`; a good board is noted at once, since the next ones may take an hour or be interrupted."""
    result = _run(name, board, place, keyword)
    if result.good and not keyword:
        with _RECORDING:
            record.good(TIERS[name])
    return result


def _run(name: str, board: qemu.Machine, place: Path, keyword: str = "") -> report.Results:
    place.mkdir(parents=True, exist_ok=True)
    if TIERS[name].installed:
        return service.test(board, place, keyword)
    if TIERS[name].remote:
        return remote.test(board, place, min(board.forwards))
    done = qemu.run(board, place, lambda line: say(f"{name:9}| {line}"))
    result = report.collect(done.results, done.console, place)
    say(f"{name}: the board ran {done.seconds:.0f} s" + ("" if done.status == 0 else f", QEMU's status {done.status}"))
    return result


def _said(name: str, run: Future[report.Results], place: Path) -> bool:
    """What a board found, or why there was none; whether all was good."""
    try:
        result = run.result()
    except VmError as error:
        say(f"{name}: FAILED: {error}")
        return False
    _print(name, result, place)
    return result.good


def _print(name: str, result: report.Results, place: Path) -> None:
    for failure in result.failures:
        say(f"{name}: FAILED {failure}")
    for found in result.reports:
        say(f"{name}: KERNEL REPORT, line {found.line} of {place / 'console.log'}:\n{found.text}")
    verdict = "good" if result.good else "FAILED"
    say(
        f"{name}: {verdict}: {result.passed} passed, {len(result.failures)} failed, {result.skipped} skipped, "
        f"{len(result.reports)} reports of the kernel ({result.facts.get('kernel', 'kernel unknown')})"
    )


# What a board that misbehaves on purpose must be caught at.
MISDEEDS = ("unreferenced object", "WARNING: ", "BUG: KASAN: ")


def selfcheck(cache: Cache, output: Path) -> int:
    """Let the board misbehave, and see that each misdeed is found; 0 where all are."""
    board = machine(cache, TIERS["custom"], ("cm.action=selfcheck",))
    found = "\n".join(report.text for report in _run("custom", board, output / "custom").reports)
    missed = [word for word in MISDEEDS if word not in found]
    for word in missed:
        say(f"FAILED: not found: {word}")
    say("selfcheck: " + ("FAILED" if missed else "good: every misdeed was found"))
    return 1 if missed else 0


def shell(cache: Cache, name: str, port: int) -> int:
    """The board on this terminal; its ports 5560 to 5562 are this host's `port` and the two after it."""
    forwards = {port + index: there for index, there in enumerate(PORTS)}
    board = machine(cache, TIERS[name], ("cm.action=shell",), forwards)
    say(f"the CM will listen on tcp://localhost:{port}; Ctrl-A X ends the board")
    return qemu.interact(board)
