# SPDX-License-Identifier: Apache-2.0
"""kmod/tests/run-kvm.sh with programs that stand in for QEMU: a KVM that is there and says nothing does not hang it."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[3] / "kmod/tests/run-kvm.sh"
# Under KVM it says nothing for ever, or boots; emulated it boots. The serial port of the probe is a file.
QEMU = """#!/bin/sh
echo "$*" >>"$CALLS"
case "$*" in *"-accel kvm"*) [ "$KVM_IS" = good ] || exec sleep 600;; esac
for word in "$@"; do
	case $word in file:*) echo "Linux version 6.1" >"${word#file:}"; exec sleep 600;; esac
done
echo "exit status $GUEST"
"""


@pytest.fixture
def tools(tmp_path: Path) -> Path:
    """A folder with stand-ins of all programs that the script asks for, and the folders that it copies from."""
    for name, text in {"qemu-system-x86_64": QEMU, "busybox": "#!/bin/sh\n", "cpio": "#!/bin/sh\ncat\n"}.items():
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    for name in ("stock", "built"):
        (tmp_path / name).mkdir()
    (tmp_path / "built/cm_core.ko").write_bytes(b"")
    (tmp_path / "kvm").write_bytes(b"")
    return tmp_path


def run(tools: Path, **variables: str) -> tuple[int, list[str]]:
    calls = tools / "calls"
    found = {"PATH": f"{tools}:{os.environ['PATH']}", "CALLS": str(calls), "KVM": str(tools / "kvm"), "GUEST": "0"}
    command = [str(SCRIPT), "image", str(tools / "stock"), str(tools / "built")]
    ended = subprocess.run(command, env=os.environ | found | variables, timeout=120, capture_output=True, check=False)
    return ended.returncode, calls.read_text().splitlines()


def test_a_broken_kvm_is_given_up_and_the_guest_emulated(tools: Path) -> None:
    status, (probe, guest) = run(tools, KVM_IS="broken", KVM_PATIENCE="1")
    assert status == 0
    assert "-accel kvm" in probe
    assert "-accel tcg" in guest


def test_a_good_kvm_is_used(tools: Path) -> None:
    status, (_, guest) = run(tools, KVM_IS="good")
    assert status == 0
    assert "-accel kvm" in guest


def test_without_kvm_nothing_is_probed(tools: Path) -> None:
    status, (guest,) = run(tools, KVM=str(tools / "none"))
    assert status == 0
    assert "-accel tcg" in guest


def test_what_fails_in_the_guest_is_told(tools: Path) -> None:
    assert run(tools, KVM=str(tools / "none"), GUEST="1")[0] == 1
