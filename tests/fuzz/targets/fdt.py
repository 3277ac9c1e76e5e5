# SPDX-License-Identifier: Apache-2.0
"""Flattened device trees: read, or FdtError; what was read is the same after it was written."""

from __future__ import annotations

from cm.formats import fdt

PACKAGES = ("cm.formats.fdt",)
MAX_LENGTH = 8192


def seeds() -> list[bytes]:
    timer = fdt.FdtNode("timer@40000000", {"compatible": b"xlnx,axi-timer-2.0\0", "reg": bytes(8)})
    tree = fdt.FdtNode("", {"model": b"board\0"}, [timer, fdt.FdtNode("soc", {}, [fdt.FdtNode("deep")])])
    return [
        fdt.pack(tree),
        fdt.pack(fdt.overlay("/axi", fdt.FdtNode("", {"firmware-name": b"design.bin\0"}))),
        fdt.write(fdt.Fdt(tree, ((0x1000, 0x20),), 1)),
    ]


def one(data: bytes) -> None:
    try:
        found = fdt.read(data)
    except fdt.FdtError:
        return
    assert fdt.read(fdt.write(found)) == found
