# SPDX-License-Identifier: Apache-2.0
"""Register maps of other tools: LiteX, axion-hdl, bust, HLS and IP-XACT, by the letter that the input begins with."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

from cm.design.errors import BuildError
from cm.design.hdl.errors import HdlError
from cm.design.hdl.register_maps import read_register_map

PACKAGES = ("cm.design.hdl.register_maps", "cm.design.hdl.json_registers", "cm.design.hdl.ipxact_registers")
MAX_LENGTH = 16384

_FOLDER = Path(tempfile.mkdtemp())
_SUFFIXES = {b"j": ".json", b"x": ".xml", b"h": ".h", b"v": "_s_axi.v"}
_LITEX = {
    "csr_registers": {
        "led_out": {"addr": 0, "size": 1, "type": "rw"},
        "timer_now": {"addr": 8, "size": 2, "type": "ro"},
    },
    "csr_bases": {"led": 0, "timer": 8},
    "constants": {"config_csr_data_width": 32},
    "memories": {"sram": {"base": 4096, "size": 64, "type": "cached"}},
}
_AXION = {
    "module": "m",
    "registers": [
        {
            "name": "status",
            "addr": 4,
            "access": "RO",
            "width": 32,
            "fields": [{"name": "mode", "bit_offset": 3, "width": 2, "access": "RW", "enum_values": {"1": "fast"}}],
        }
    ],
}
_BUST = {
    "bus": {"type": "axi4lite", "addr_width": 32, "data_width": 32},
    "module": {
        "name": "m",
        "register": [
            {"name": "ctrl", "mode": "rw", "width": 32, "address": 0, "reset": "0x0", "fields": []},
            {"name": "state", "mode": "ro", "width": 8, "address": 8, "reset": "0x1", "fields": []},
        ],
    },
}
_HLS = {"top": "f", "bundle": {"control": {}}, "argument": {"n": {"offset": 16, "width": 32, "bundle": "control"}}}
_IPXACT = """<ipxact:component xmlns:ipxact="http://www.accellera.org/XMLSchema/IPXACT/1685-2014"><ipxact:memoryMaps>
<ipxact:memoryMap><ipxact:name>s</ipxact:name><ipxact:addressBlock><ipxact:name>b</ipxact:name>
<ipxact:baseAddress>0</ipxact:baseAddress><ipxact:register><ipxact:name>r</ipxact:name><ipxact:dim>2</ipxact:dim>
<ipxact:addressOffset>4</ipxact:addressOffset><ipxact:size>32</ipxact:size><ipxact:field><ipxact:name>f</ipxact:name>
<ipxact:bitOffset>1</ipxact:bitOffset><ipxact:bitWidth>2</ipxact:bitWidth><ipxact:access>read-only</ipxact:access>
</ipxact:field></ipxact:register></ipxact:addressBlock></ipxact:memoryMap></ipxact:memoryMaps></ipxact:component>"""
_COMMENTS = b"// 0x10 : Data signal of rows\n//        bit 31~0 - rows[31:0] (Read/Write)\n"


def seeds() -> list[bytes]:
    """One file of each kind."""
    said = [b"j" + json.dumps(one).encode() for one in (_LITEX, _AXION, _BUST, _HLS)]
    return [*said, b"x" + _IPXACT.encode(), b"h" + b"#define XF_CONTROL_ADDR_N_DATA 0x10\n", b"v" + _COMMENTS]


def one(data: bytes) -> None:
    """A map is read or refused by name."""
    path = _FOLDER / f"map{_SUFFIXES.get(data[:1], '.json')}"
    path.write_bytes(data[1:])
    try:
        found = read_register_map(path, "m")
    except (BuildError, HdlError):
        return
    assert found.registers or found.memories
