# SPDX-License-Identifier: Apache-2.0
"""Temperatures and voltages from sysfs, in files as the kernel documents them."""

from __future__ import annotations

from pathlib import Path

import pytest

from cm.device.paths import Root
from cm.device.sensors import Reading, read_sensors


def board(folder: Path, **files: str) -> Root:
    """Make a root with these files; a key is a path with ``/`` written as ``__``."""
    for name, text in files.items():
        path = folder / name.replace("__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{text}\n")
    return Root(str(folder))


def iio(folder: Path, number: int = 0, **files: str) -> Root:
    return board(folder, **{f"sys__bus__iio__devices__iio:device{number}__{name}": t for name, t in files.items()})


def hwmon(folder: Path, number: int = 0, **files: str) -> Root:
    return board(folder, **{f"sys__class__hwmon__hwmon{number}__{name}": t for name, t in files.items()})


def test_a_board_without_sensors_has_none(tmp_path: Path) -> None:
    assert read_sensors(Root(str(tmp_path))) == ()


def test_the_temperature_of_a_zynq_follows_its_transfer_function(tmp_path: Path) -> None:
    # UG480: °C = code × 503.975 / 4096 - 273.15; the driver's offset is rounded to a whole code.
    root = iio(tmp_path, name="xadc", in_temp0_raw="2550", in_temp0_offset="-2219", in_temp0_scale="123.040771484")
    (found,) = read_sensors(root)
    assert (found.device, found.name, found.quantity) == ("xadc", "temp0", "temperature")
    assert found.value == pytest.approx(2550 * 503.975 / 4096 - 273.15, abs=0.15)


def test_a_channel_with_an_extended_name_is_called_by_it(tmp_path: Path) -> None:
    root = iio(tmp_path, name="xadc", in_voltage0_vccint_raw="1365", in_voltage0_vccint_scale="0.732421875")
    assert read_sensors(root) == (Reading("xadc", "vccint", "voltage", pytest.approx(0.99976, abs=1e-5)),)


def test_a_label_takes_precedence_over_a_number(tmp_path: Path) -> None:
    files = {"in_temp7_raw": "41690", "in_temp7_offset": "-36058", "in_temp7_scale": "7.771514892"}
    root = iio(tmp_path, name="xilinx-ams", in_temp7_label="Temp_LPD", **files)
    assert [(r.name, round(r.value, 2)) for r in read_sensors(root)] == [("Temp_LPD", 43.77)]


def test_channels_share_the_scale_of_their_kind(tmp_path: Path) -> None:
    root = iio(tmp_path, name="adc", in_voltage0_raw="1000", in_voltage1_raw="2000", in_voltage_scale="0.5")
    assert [(r.name, r.value) for r in read_sensors(root)] == [("voltage0", 0.5), ("voltage1", 1.0)]


def test_a_value_that_the_driver_has_already_scaled_is_used_unchanged(tmp_path: Path) -> None:
    root = iio(tmp_path, name="t", in_temp_input="21500", in_temp_scale="7")
    assert read_sensors(root) == (Reading("t", "temp", "temperature", 21.5),)


def test_differential_channels_and_limits_are_not_sensors(tmp_path: Path) -> None:
    limit = {"in_voltage0_thresh_rising_value": "9", "in_voltage0-voltage1_raw": "5"}
    assert read_sensors(iio(tmp_path, name="adc", **limit)) == ()


def test_a_disk_of_qemus_is_as_warm_as_its_model_says(tmp_path: Path) -> None:
    """The files of Linux 6.1 (Debian, arm64, nvme with NVME_HWMON); QEMU's model says 323 K in its SMART log."""
    files = {"temp1_crit": "99850", "temp1_alarm": "0", "temp1_input": "49850", "temp1_min": "-273150"}
    root = hwmon(tmp_path, name="nvme", uevent="OF_NAME=pcie", temp1_label="Composite", temp1_max="69850", **files)
    assert read_sensors(root) == (Reading("nvme", "Composite", "temperature", pytest.approx(323 - 273.15)),)


def test_hwmon_counts_in_thousandths_and_power_in_millionths(tmp_path: Path) -> None:
    root = hwmon(
        tmp_path, name="ina226", in1_input="12032", curr1_input="412", power1_input="4950000", temp1_input="31500"
    )
    found = {r.name: (r.quantity, round(r.value, 6)) for r in read_sensors(root)}
    assert found == {
        "in1": ("voltage", 12.032),
        "curr1": ("current", 0.412),
        "power1": ("power", 4.95),
        "temp1": ("temperature", 31.5),
    }


def test_channels_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    root = hwmon(tmp_path, name="x", in10_input="10", in2_input="2", in1_input="1", in2_label="core")
    assert [r.name for r in read_sensors(root)] == ["in1", "core", "in10"]


@pytest.mark.parametrize("text", ["", "busy", "nan", "inf", "1 2"])
def test_a_channel_whose_value_is_not_a_number_is_left_out(tmp_path: Path, text: str) -> None:
    assert [r.name for r in read_sensors(hwmon(tmp_path, name="x", in1_input=text, in2_input="2"))] == ["in2"]


def test_a_channel_that_cannot_be_read_is_left_out(tmp_path: Path) -> None:
    root = hwmon(tmp_path, name="x", in2_input="2")
    (tmp_path / "sys/class/hwmon/hwmon0/in1_input").mkdir()
    assert [r.name for r in read_sensors(root)] == ["in2"]


def test_a_board_with_very_many_sensors_reports_some(tmp_path: Path) -> None:
    assert len(read_sensors(hwmon(tmp_path, **{f"in{n}_input": "1" for n in range(300)}))) == 64
