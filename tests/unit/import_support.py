# SPDX-License-Identifier: Apache-2.0
"""Small made-up packages in the formats of PYNQ and dfx-mgr."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path

from bitstream_support import frames

from cm.formats.bitstream import FrameAddress, FrameRun, assemble

HWH = """\
<?xml version="1.0" encoding="UTF-8" standalone="no" ?>
<EDKSYSTEM EDWVERSION="1.2" TIMESTAMP="Tue Apr 30 12:22:27 2019" VIVADOVERSION="2022.1">
  <SYSTEMINFO ARCH="zynq" DEVICE="{device}" NAME="{design}" PACKAGE="clg400" SPEEDGRADE="-1"/>
  <EXTERNALINTERFACES>{external}</EXTERNALINTERFACES>
  <MODULES>{modules}</MODULES>
</EDKSYSTEM>
"""


def hwh(*modules: str, device: str = "7z020", design: str = "top", external: str = "") -> bytes:
    """A hardware handoff with these modules."""
    text = HWH.format(device=device, design=design, modules="".join(modules), external=external)
    return b"\xef\xbb\xbf" + text.encode()  # Vivado writes a byte order mark


def module(
    instance: str, kind: str, *parts: str, parameters: Mapping[str, str] | None = None, region: bool = False
) -> str:
    """A MODULE; `parts` are its PORTS, BUSINTERFACES and so on."""
    given = "".join(f'<PARAMETER NAME="{key}" VALUE="{value}"/>' for key, value in (parameters or {}).items())
    extra = ' BDTYPE="RBD"' if region else ""
    return (
        f'<MODULE FULLNAME="/{instance}" INSTANCE="{instance}" MODTYPE="{kind}" VLNV="xilinx.com:ip:{kind}:1.0"{extra}>'
        f"<PARAMETERS>{given}</PARAMETERS>{''.join(parts)}</MODULE>"
    )


def ports(*items: str) -> str:
    return f"<PORTS>{''.join(items)}</PORTS>"


def port(
    name: str, direction: str, *ends: tuple[str, str], kind: str = "undef", bits: int = 1, sensitivity: str = ""
) -> str:
    """A port connected to (instance, port) ends."""
    found = "".join(f'<CONNECTION INSTANCE="{instance}" PORT="{other}"/>' for instance, other in ends)
    width = f'LEFT="{bits - 1}" RIGHT="0" ' if bits > 1 else ""
    width += f'SENSITIVITY="{sensitivity}" ' if sensitivity else ""
    return f'<PORT DIR="{direction}" NAME="{name}" {width}SIGIS="{kind}"><CONNECTIONS>{found}</CONNECTIONS></PORT>'


def buses(*items: tuple[str, str, str]) -> str:
    """The BUSINTERFACES of streams: (name, MASTER or SLAVE, net)."""
    vlnv = "xilinx.com:interface:axis:1.0"
    found = (f'<BUSINTERFACE NAME="{name}" TYPE="{kind}" BUSNAME="{net}" VLNV="{vlnv}"/>' for name, kind, net in items)
    return f"<BUSINTERFACES>{''.join(found)}</BUSINTERFACES>"


def memory(*ranges: tuple[str, int, int]) -> str:
    """A MEMORYMAP of (instance, base, size) register ranges."""
    return "<MEMORYMAP>" + "".join(memory_range(*item) for item in ranges) + "</MEMORYMAP>"


def memory_range(instance: str, base: int, size: int, kind: str = "REGISTER") -> str:
    addresses = f'BASEVALUE="0x{base:08X}" HIGHVALUE="0x{base + size - 1:08X}"'
    return (
        f'<MEMRANGE ADDRESSBLOCK="Reg" {addresses} INSTANCE="{instance}" MASTERBUSINTERFACE="M_AXI_GP0"'
        f' MEMTYPE="{kind}" SLAVEBUSINTERFACE="S_AXI"/>'
    )


def described(*registers: str) -> str:
    """The ADDRESSBLOCKS of an IP that describes its registers."""
    inner = "".join(registers)
    return (
        '<ADDRESSBLOCKS><ADDRESSBLOCK ACCESS="read-write" INTERFACE="S_AXI" NAME="Reg" RANGE="65536">'
        f"<REGISTERS>{inner}</REGISTERS></ADDRESSBLOCK></ADDRESSBLOCKS>"
    )


def register(name: str, offset: int, *fields: str, size: int = 32, access: str = "read-write", **more: str) -> str:
    found = {"DESCRIPTION": f"The {name}", "ADDRESS_OFFSET": str(offset), "SIZE": str(size), "ACCESS": access, **more}
    return f'<REGISTER NAME="{name}">{_properties(found)}<FIELDS>{"".join(fields)}</FIELDS></REGISTER>'


def register_field(name: str, lsb: int, width: int, access: str = "read-write", **more: str) -> str:
    found = {"BIT_OFFSET": str(lsb), "BIT_WIDTH": str(width), "ACCESS": access, **more}
    return f'<FIELD NAME="{name}">{_properties(found)}</FIELD>'


def _properties(values: Mapping[str, str]) -> str:
    return "".join(f'<PROPERTY NAME="{key}" VALUE="{value}"/>' for key, value in values.items())


def bitstream(column: int | None = None, device: str = "xc7z020", count: int = 1) -> bytes:
    """A partial bitstream that writes this column, or (None) a full one."""
    run = FrameRun(FrameAddress(0, 0, column or 0), frames(count))
    return assemble(device, [run], partial=column is not None)


def dtbo(tree: Mapping[str, object]) -> bytes:
    """A flattened device tree: dicts are nodes, bytes and strings properties, None an empty one."""
    names: dict[str, int] = {}
    strings = bytearray()

    def pad(raw: bytes) -> bytes:
        return raw + bytes(-len(raw) % 4)

    def name_offset(name: str) -> int:
        if name not in names:
            names[name] = len(strings)
            strings.extend(name.encode() + b"\0")
        return names[name]

    def node(name: str, items: Mapping[str, object]) -> bytes:
        out = struct.pack(">I", 1) + pad(name.encode() + b"\0")
        for key, value in items.items():
            if isinstance(value, dict):
                out += node(key, value)
            else:
                raw = value.encode() + b"\0" if isinstance(value, str) else value or b""
                assert isinstance(raw, bytes)
                out += struct.pack(">3I", 3, len(raw), name_offset(key)) + pad(raw)
        return out + struct.pack(">I", 2)

    body = node("", tree) + struct.pack(">I", 9)
    sizes = (56 + len(body), 40, 17, 16, 0, len(strings), len(body))
    header = struct.pack(">10I", 0xD00DFEED, 56 + len(body) + len(strings), 56, *sizes)
    return header + bytes(16) + body + bytes(strings)


def slot_overlay(number: int, firmware: str | None, device: bool = False) -> bytes:
    """An overlay for `fpga_PR<number>` that loads `firmware` and may add a device."""
    inside: dict[str, object] = {}
    if firmware is not None:
        inside = {"firmware-name": firmware, "partial-fpga-config": None}
    if device:
        inside["config@80000000"] = {"compatible": "generic-uio"}
    fragment = {"target": b"\xff\xff\xff\xff", "__overlay__": inside}
    return dtbo({"fragment@0": fragment, "__fixups__": {f"fpga_PR{number}": "/fragment@0:target:0"}})


def key_pair(folder: Path, name: str, signers: Path) -> Path:
    """Keys as openssl writes them; without openssl, made by the library that also verifies them."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    key = Ed25519PrivateKey.generate()
    private = folder / f"{name}.pem"
    none, pem = serialization.NoEncryption(), serialization.Encoding.PEM
    private.write_bytes(key.private_bytes(pem, serialization.PrivateFormat.PKCS8, none))
    signers.mkdir(exist_ok=True)
    public = key.public_key().public_bytes(pem, serialization.PublicFormat.SubjectPublicKeyInfo)
    (signers / f"{name}.pub.pem").write_bytes(public)
    return private
