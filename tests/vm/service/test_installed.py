# SPDX-License-Identifier: Apache-2.0
"""What the commands of the README leave behind."""

from __future__ import annotations

import re

from board import Board


def test_the_service_runs_as_its_own_user_with_one_capability(board: Board) -> None:
    assert board.unit("ActiveState") == "active"
    assert board.unit("NRestarts") == "0"
    status = dict(re.findall(r"(\w+):\s+(.*)", board.do(f"cat /proc/{board.unit('MainPID')}/status")))
    numbers = board.do("id -u cm; getent group fpga | cut -d : -f 3").split()
    assert (status["Uid"].split(), status["Gid"].split()) == ([numbers[0]] * 4, [numbers[1]] * 4)
    assert int(status["CapEff"], 16) == 1 << 1  # CAP_DAC_OVERRIDE
    assert (status["NoNewPrivs"], status["Seccomp"]) == ("1", "2")


def test_the_kernel_modules_are_those_that_dkms_built_on_the_board(board: Board) -> None:
    assert "installed" in board.do("dkms status fpga-cm")
    loaded = board.do("lsmod").splitlines()
    assert {"cm_dma", "cm_icap"} <= {line.split()[0] for line in loaded}
    assert "/updates/dkms/" in board.do("modinfo -n cm_dma")


def test_device_nodes_are_the_groups(board: Board) -> None:
    nodes = board.do("stat -c '%G %a %n' /dev/uio* /dev/cm_dma/* /dev/cm_icap*").splitlines()
    assert len(nodes) >= 6
    assert {tuple(line.split()[:2]) for line in nodes} == {("fpga", "660")}, nodes


def test_a_package_manager_finds_nothing_amiss(board: Board) -> None:
    assert board.do("dpkg --audit") == ""
    amiss = board.do("dpkg --verify fpga-cm").splitlines()  # but for what this board wants to be without
    assert [line for line in amiss if not line.split()[-1].startswith(("/usr/share/doc/", "/usr/share/man/"))] == []


def test_the_settings_that_were_installed_are_right(board: Board) -> None:
    board.do("cm check --settings")
