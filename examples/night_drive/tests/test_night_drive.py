# SPDX-License-Identifier: Apache-2.0
"""The application on the simulated board that runs its Verilog."""

import numpy as np
import pytest
from night_drive import drive

from cm.errors import CmError

BRIGHT = np.full((60, 80), 200, np.uint8)
DARK = np.arange(4800, dtype=np.uint8).reshape(60, 80) % 50


def test_by_day_pictures_stay_as_they_are(rtl_board):
    assert np.array_equal(drive(rtl_board, BRIGHT), BRIGHT)


def test_when_it_gets_dark_the_night_module_is_loaded_and_brightens(rtl_board):
    assert np.array_equal(drive(rtl_board, DARK), 2 * DARK)
    rtl_board.registers["gain"] = 5
    assert np.array_equal(drive(rtl_board, DARK), 5 * DARK)


def test_a_load_that_fails_leaves_the_day(rtl_board, inject):
    inject("icap_crc")
    with pytest.raises(CmError, match="CRC"):
        drive(rtl_board, DARK)
    assert rtl_board.mode == "day"
    assert np.array_equal(drive(rtl_board, BRIGHT), BRIGHT)
