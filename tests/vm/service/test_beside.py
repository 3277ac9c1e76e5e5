# SPDX-License-Identifier: Apache-2.0
"""What users do beside the service."""

from __future__ import annotations

from beside import Beside


def test_the_simulated_board_is_a_package_of_its_own(beside: Beside) -> None:
    assert beside.refused.status != 0
    assert "fpga-cm-sim" in beside.refused.said
    done = beside.simulated()
    assert done.out.splitlines()[-1].startswith("camera "), done.said


def test_the_wheel_installs_with_the_boards_own_packages_and_works(beside: Beside) -> None:
    done = beside.wheel()
    assert done.status == 0, done.said
    assert "/home/carol/wheel/" in done.out
