# SPDX-License-Identifier: Apache-2.0
"""What the board measures, in sysfs as the kernel's drivers have it; the values do not change.

An XADC (drivers/iio/adc/xilinx-xadc-core.c, 12 bits) or an AMS (xilinx-ams.c) by the device's family, and a power
monitor of the board (drivers/hwmon/ina2xx.c). They are plain files: write to them for other values.
"""

from __future__ import annotations

from collections.abc import Iterator

from cm.simulation.software.transport.root import Root

_XADC = {
    "in_temp0_raw": "2550",
    "in_temp0_offset": "-2219",
    "in_temp0_scale": "123.040771484",
    "in_voltage0_vccint_raw": "1365",
    "in_voltage0_vccint_scale": "0.732421875",
    "in_voltage1_vccaux_raw": "2457",
    "in_voltage1_vccaux_scale": "0.732421875",
}
_AMS = {
    "in_temp7_raw": "41690",
    "in_temp7_label": "Temp_LPD",
    "in_temp7_offset": "-36058",
    "in_temp7_scale": "7.771514892",
    "in_temp20_raw": "41412",
    "in_temp20_label": "Temp_PL",
    "in_temp20_offset": "-36058",
    "in_temp20_scale": "7.771514892",
    "in_voltage21_raw": "18568",
    "in_voltage21_label": "VCCINT",
    "in_voltage21_scale": "0.045776367",
}
_INA = {
    "in1_input": "12032",
    "curr1_input": "412",
    "power1_input": "4950000",
}


def serve_sensors(root: Root, family: str) -> None:
    """Make the files."""
    for path, text in _files(family):
        root.write(path, f"{text}\n")


def _files(family: str) -> Iterator[tuple[str, str]]:
    name, channels = ("xadc", _XADC) if family == "7series" else ("xilinx-ams", _AMS)
    yield "sys/bus/iio/devices/iio:device0/name", name
    yield from ((f"sys/bus/iio/devices/iio:device0/{file}", text) for file, text in channels.items())
    yield "sys/class/hwmon/hwmon0/name", "ina226"
    yield from ((f"sys/class/hwmon/hwmon0/{file}", text) for file, text in _INA.items())
