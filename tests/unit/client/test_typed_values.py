# SPDX-License-Identifier: Apache-2.0
"""What the bits of a register mean."""

from __future__ import annotations

import pytest

from cm.client.core.typed_values import decoded, encoded
from cm.errors import InvalidRequest
from cm.wire.messages.status import RegisterInfo


def info(kind: str, width: int = 32, fraction: int = 0) -> RegisterInfo:
    return RegisterInfo("r", 0, width, "rw", type=kind, fraction=fraction)


@pytest.mark.parametrize(
    ("of", "value", "bits"),
    [
        (info(""), 7, 7),
        (info("int"), -1, 0xFFFFFFFF),
        (info("int", 16), -0x8000, 0x8000),
        (info("int", 16, 8), -1.5, 0xFE80),
        (info("", 16, 8), 255.99609375, 0xFFFF),
        (info("float32"), -0.5, 0xBF000000),
        (info("float64", 64), 0.1, 0x3FB999999999999A),
    ],
)
def test_a_value_is_these_bits(of: RegisterInfo, value: float, bits: int) -> None:
    assert encoded(of, value) == bits
    assert decoded(of, bits) == value


@pytest.mark.parametrize(
    ("of", "value", "said"),
    [
        (info(""), -1, "holds 0 to 4.29497e"),
        (info(""), 1.5, "whole numbers, not 1.5"),
        (info("int", 16), 0x8000, "holds -32768 to 32767, not 32768"),
        (info("int", 16, 8), 128, "holds -128 to 127.996, not 128"),
        (info("float32"), 1e40, "too large for float32"),
    ],
)
def test_a_number_that_a_register_cannot_hold_is_refused(of: RegisterInfo, value: float, said: str) -> None:
    with pytest.raises(InvalidRequest, match=said):
        encoded(of, value)
