# SPDX-License-Identifier: Apache-2.0
"""The watch over a kernel's log, and the bookkeeping of what was built."""

from __future__ import annotations

import sys
import tarfile
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))

from vmboard import qemu, report
from vmboard.arch import ARM64
from vmboard.cache import Cache, digest
from vmboard.errors import EXIT_MISSING
from vmboard.main import main

CLEAN = """\
[    0.000000] Linux version 6.1.192-cm
[    0.000000] Kernel command line: console=ttyAMA0 panic=-1
[    0.100000] DMA-API: preallocated 65536 debug entries
[    0.100000] DMA-API: debugging enabled by kernel config
[    0.200000] kmemleak: Kernel memory leak detector initialized (mem pool available: 15600)
[    0.200000] kmemleak: Automatic memory scanning thread started
[    8.400000] cm_dma: loading out-of-tree module taints kernel.
[    8.400000] cm_dma: module verification failed: signature and/or required key missing - tainting kernel
[    9.000000] OF: overlay: WARNING: memory leak will occur if overlay removed, property: /__symbols__/prr0
"""
REPORTS = {
    "kasan": "BUG: KASAN: slab-use-after-free in cm_queue_take+0x1c/0x40",
    "lockdep": "WARNING: possible circular locking dependency detected",
    "recursive": "WARNING: possible recursive locking detected",
    "state": "WARNING: inconsistent lock state",
    "dma": "DMA-API: cm_plsim_dma cm_plsim_dma.0: device driver frees DMA memory with wrong function",
    "leak": "kmemleak: 3 new suspected memory leaks (see /sys/kernel/debug/kmemleak)",
    "object": "unreferenced object 0xffff000003a5d000 (size 1024):",
    "warn": "WARNING: CPU: 1 PID: 73 at kernel/dma/debug.c:973 check_unmap+0x4d0/0x8b0",
    "oops": "Unable to handle kernel NULL pointer dereference at virtual address 0000000000000018",
    "atomic": "BUG: sleeping function called from invalid context at mm/slab.h:494",
    "hung": "INFO: task python3:88 blocked for more than 60 seconds.",
    "stall": "rcu: INFO: rcu_preempt detected stalls on CPUs/tasks",
    "property": "OF: overlay: WARNING: memory leak will occur if overlay removed, property: /pl-bus/status",
    "overlay": "OF: ERROR: memory leak, expected refcount 1 instead of 2, of_node_get()/of_node_put() unbalanced",
}


def test_a_clean_log_has_no_reports() -> None:
    assert report.scan(CLEAN) == []


@pytest.mark.parametrize("line", REPORTS.values(), ids=REPORTS)
def test_each_kind_of_report_is_found(line: str) -> None:
    found = report.scan(f"{CLEAN}[    9.000000] {line}\n")
    assert [(one.line, line in one.text) for one in found] == [(10, True)]


def test_lines_of_one_report_are_one_report() -> None:
    log = CLEAN + "BUG: KASAN: x\nCall trace:\n a\n b\n" + "quiet\n" * 60 + "WARNING: CPU: 0 PID: 1\n"
    assert [one.line for one in report.scan(log)] == [10, 74]


def sent(place: Path, xml: str, status: int = 0, leaks: str = "") -> report.Results:
    """What a board's archive with this JUnit file is read as."""
    files = {"cases.xml": xml, "facts": f"status={status}\nkernel=6.1.0 aarch64\n", "kmemleak": leaks}
    with tarfile.open(place / "results.tar", "w") as archive:
        for name, text in files.items():
            (place / name).write_text(text)
            archive.add(place / name, name)
    (place / "console.log").write_text(CLEAN)
    return report.collect(place / "results.tar", place / "console.log", place)


def test_a_board_that_passed_is_good(tmp_path: Path) -> None:
    result = sent(tmp_path, '<testsuite><testcase classname="a" name="b"/></testsuite>')
    assert (result.good, result.passed, result.facts["kernel"]) == (True, 1, "6.1.0 aarch64")


def test_a_failed_case_is_reported_with_its_text(tmp_path: Path) -> None:
    xml = '<testsuite><testcase classname="a" name="b"><failure>why</failure></testcase></testsuite>'
    result = sent(tmp_path, xml, status=1)
    assert (result.good, result.failures) == (False, ("a::b\nwhy",))


def test_a_leak_fails_a_board_whose_tests_passed(tmp_path: Path) -> None:
    leaks = "unreferenced object 0xffff000003a5d000 (size 64):\n  backtrace:\n    cm_node_add\n"
    result = sent(tmp_path, '<testsuite><testcase classname="a" name="b"/></testsuite>', leaks=leaks)
    assert (result.passed, len(result.reports), result.good) == (1, 1, False)


def test_a_run_that_tested_nothing_is_not_good(tmp_path: Path) -> None:
    assert not sent(tmp_path, "<testsuite/>").good


def test_tests_that_ended_early_are_a_failure(tmp_path: Path) -> None:
    result = sent(tmp_path, '<testsuite><testcase classname="a" name="b"/></testsuite>', status=4)
    assert not result.good


def test_a_board_that_sent_nothing_failed(tmp_path: Path) -> None:
    (tmp_path / "console.log").write_text("Kernel panic - not syncing: no init\n")
    result = report.collect(tmp_path / "results.tar", tmp_path / "console.log", tmp_path)
    assert "no results" in result.failures[0]
    assert not result.good


def test_the_hash_depends_on_names_and_contents(tmp_path: Path) -> None:
    folder = tmp_path / "a"
    folder.mkdir()
    (folder / "x.c").write_text("1")
    first = digest(folder)
    (folder / "x.o").write_text("made")
    assert digest(folder) == first
    (folder / "x.c").write_text("2")
    assert digest(folder) != first


def test_an_interrupted_build_is_done_again(tmp_path: Path) -> None:
    cache = Cache(tmp_path)

    def breaks(place: Path) -> None:
        (place / "half").touch()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cache.entry("thing", ["in"], breaks)
    place = cache.entry("thing", ["in"], lambda place: (place / "whole").touch())
    assert sorted(path.name for path in place.iterdir()) == [".complete", "whole"]


def test_a_host_without_qemu_exits_distinctly(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["--cache", str(tmp_path), "test", "--tier", "stock"]) == EXIT_MISSING
    said = capsys.readouterr().err
    assert "not installed: qemu-system-aarch64, depmod" in said
    assert "apt install" in said
    assert "kmod" in said


_SILENT_ONCE = "if [ -e once ]; then echo Linux >console.log; echo passed >output.log; else >once; exec sleep 60; fi"


def test_a_kernel_that_says_nothing_is_booted_once_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(qemu, "SILENCE_S", 0.5)
    monkeypatch.setattr(qemu, "logged", lambda _, place: ["sh", "-c", f"cd {place} && {_SILENT_ONCE}"])
    board = qemu.Machine(ARM64, tmp_path, tmp_path, tmp_path, memory_mb=1)
    lines: list[str] = []
    assert qemu.run(board, tmp_path, lines.append).status == 0
    assert [line.split()[-1] for line in lines] == ["more", "passed"]
