# SPDX-License-Identifier: Apache-2.0
"""The port's status register: its descriptions agree with kmod/include/cm_icap_port.h.

The RTL is compared with it in tests/rtl, the driver with each bit in tests/vm/cases/test_silicon.py.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[3]
HEADER = (ROOT / "kmod/include/cm_icap_port.h").read_text()
BITS = {name: int(bit) for name, bit in re.findall(r"#define CM_ICAP_SR_([A-Z]+) BIT\((\d+)\)", HEADER)}
ERRORS = re.search(r"#define CM_ICAP_SR_ERRORS GENMASK\((\d+), (\d+)\)", HEADER)


def test_the_header_defines_the_bits() -> None:
    assert set(BITS) == {"DONE", "FAILED", "EOS"}
    assert ERRORS is not None


@pytest.mark.parametrize("name", sorted(BITS))
@pytest.mark.parametrize("place", ["dts/bindings/fpga-cm,icap-loader.yaml", "docs/kernel.md"])
def test_what_describes_a_bit_gives_its_number(place: str, name: str) -> None:
    text = (ROOT / place).read_text()
    if place.endswith(".yaml"):
        text = yaml.safe_load(text)["properties"]["reg"]["description"]
    assert re.search(rf"bit {BITS[name]}\s+{name}\b", text, re.IGNORECASE)


@pytest.mark.parametrize("place", ["dts/bindings/fpga-cm,icap-loader.yaml", "docs/kernel.md"])
def test_what_describes_the_cause_gives_its_bits(place: str) -> None:
    assert ERRORS is not None
    high, low = ERRORS.groups()
    assert re.search(rf"bits {low}(–| to ){high}", (ROOT / place).read_text())


def test_the_rtl_says_where_its_bits_are() -> None:
    said = re.search(r"0x014 ICAP +ro +\[(\d)\] and \[(\d)\] last load ended, \[(\d)\] error", control())
    assert said is not None
    assert [int(bit) for bit in said.groups()] == [BITS["DONE"], BITS["EOS"], BITS["FAILED"]]


def control() -> str:
    return (ROOT / "cm/design/rtl/cm_control.v").read_text()
