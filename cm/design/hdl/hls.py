# SPDX-License-Identifier: Apache-2.0
"""HLS C++ → the ports that Vitis HLS gives a function, by its arguments and `#pragma HLS INTERFACE` lines.

The rules are UG1399's ("Defining Interfaces"); the names are those in files that Vitis HLS wrote: streams
are ``ARG_TDATA`` …, registers a slave ``s_axi_BUNDLE``, memory a master ``m_axi_BUNDLE``; names that are
keywords of Verilog or VHDL get ``_r``. Types are resolved through typedefs, macros and constants of the
files; no other C++ is understood, and an argument of any other type is refused by name.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from cm.design.hdl import hls_text
from cm.design.hdl.detect import Detector
from cm.design.hdl.errors import HdlError
from cm.design.hdl.hls_map import Arg, lite_bits, places
from cm.design.hdl.hls_types import Packet, Types
from cm.design.hdl.model import Language, ModuleInfo, Port, PortDirection
from cm.design.hdl.protocols import UserProtocol
from cm.design.project.model import HlsSpec, RegisterSpec
from cm.schema.model import Access

IN, OUT = PortDirection.IN, PortDirection.OUT
_VHDL = """
    abs access after alias all and architecture array assert attribute begin block body buffer bus case component
    configuration constant disconnect downto else elsif end entity exit file for function generate generic group guarded
    if impure in inertial inout is label library linkage literal loop map mod nand new next nor not null of on open or
    others out package port postponed procedure process pure range record register reject rem report return rol ror
    select severity shared signal sla sll sra srl subtype then to transport type unaffected units until use variable
    wait when while with xnor xor"""
_VERILOG = """
    always assign casex casez deassign default defparam disable edge endcase endfunction endmodule endtask event force
    forever fork initial input integer join medium module negedge output parameter posedge primitive real realtime reg
    release repeat scalared small specify strong supply0 supply1 table task time tri vectored wand weak wire wor"""
_RESERVED = frozenset(f"{_VHDL} {_VERILOG}".split())


@dataclass(slots=True)
class _Function:
    name: str
    file: Path
    line: int
    args: list[Arg]
    pragmas: dict[str, dict[str, str]] = field(default_factory=dict)  # by argument, in lower case keys


def load_hls(spec: HlsSpec, top: str | None = None, protocols: Sequence[UserProtocol] = ()) -> ModuleInfo:
    """Read the function `top` (default: the only one with interface pragmas) as a module. Raises `HdlError`."""
    function = _function(spec, top)
    ports = [Port(n, d, w, str(function.file), function.line) for n, d, w in _ports(function)]
    buses = {port.name.rpartition("_")[0] for port in ports if port.name.endswith(("_TVALID", "_ARVALID"))}
    said = f"ASSOCIATED_BUSIF {':'.join(sorted(buses))}, ASSOCIATED_RESET ap_rst_n"  # as in Vitis HLS's component.xml
    ports[0] = replace(ports[0], attributes={"x_interface_parameter": said})
    info = ModuleInfo(function.name, str(function.file), Language.HLS, function.line, ports=tuple(ports))
    return Detector(protocols).detect(info)


def _function(spec: HlsSpec, top: str | None) -> _Function:
    path, text, name, found = _definition(spec, top)
    headers = hls_text.headers(path, text, spec.cflags)
    types = Types("\n".join([*(hls_text.clean(_read(header)) for header in headers), text]), spec.cflags)
    pragmas = hls_text.pragmas(found.body)
    args = [_arg(path, found.line, declared, types, pragmas, found.body, text) for declared in found.arguments]
    return _Function(name, path, found.line, args, pragmas)


def _definition(spec: HlsSpec, top: str | None) -> tuple[Path, str, str, hls_text.Definition]:
    """File, text, name and definition of the function."""
    for path in spec.sources:
        text = hls_text.clean(_read(path))
        name = top or hls_text.only_top(text)
        found = hls_text.definition(text, name) if name else None
        if name and found:
            return path, text, name, found
    wanted = f"function {top}" if top else "one function with #pragma HLS INTERFACE"
    raise HdlError(f"{', '.join(map(str, spec.sources))}: no {wanted} in it: name top:")


def _arg(
    path: Path,
    line: int,
    declared: hls_text.Declared,
    types: Types,
    pragmas: Mapping[str, Mapping[str, str]],
    body: str,
    text: str,
) -> Arg:
    where = f"{path}:{line}: argument {declared.name}"
    said = pragmas.get(declared.name, {})
    packet = types.stream(declared.type)
    width = packet.data if packet else types.width(declared.type)
    if width is None:
        raise HdlError(f"{where}: the width of its type {declared.type} is not known: only integers, ap_ types, float,"
                       " hls::stream and their typedefs in these files are")  # fmt: skip
    mode = said.get("mode") or ("axis" if packet else "")
    if packet and mode not in ("axis", ""):
        raise HdlError(f"{where}: a stream with mode={mode}: only axis is understood")
    if mode == "axis" and packet is None:
        packet = types.packet(declared.type)
    reads, writes = hls_text.uses(declared.name, body, text, bool(packet))
    if packet and reads == writes:
        raise HdlError(f"{where}: whether the stream is read or written cannot be seen in {path.name}: use .read() or"
                       " .write() in it, or give the exported component.xml")  # fmt: skip
    return Arg(declared.name, width, declared.indirect, mode, said, writes and not declared.constant, reads, packet)


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise HdlError(f"{path}: cannot be read: {error.strerror}") from None


def rtl_name(name: str) -> str:
    """The name of an argument in the HDL."""
    return f"{name}_r" if name.lower() in _RESERVED else name


def _ports(function: _Function) -> Iterator[tuple[str, PortDirection, int]]:
    control = function.pragmas.get("return", {})
    yield from (("ap_clk", IN, 1), ("ap_rst_n", IN, 1))
    bundles: dict[str, list[Arg]] = {}
    masters: dict[str, int] = {}
    for arg in function.args:
        mode = arg.mode
        if arg.packet:
            yield from _stream(rtl_name(arg.name), arg.packet, IN if arg.reads else OUT)
        elif mode == "m_axi":
            bundle = arg.said.get("bundle", "gmem")
            masters[bundle] = max(masters.get(bundle, 0), 8 * -(-arg.width // 8), 32)
            if arg.said.get("offset", "slave") == "slave":
                bundles.setdefault(arg.said.get("lite", "control"), []).append(arg)
        elif mode == "s_axilite":
            bundles.setdefault(arg.said.get("bundle", "control"), []).append(arg)
        elif mode in ("", "ap_none", "ap_stable", "ap_vld"):
            yield from _plain(function, arg)
        else:
            raise HdlError(f"{function.file}:{function.line}: argument {arg.name}: interface mode {mode} is not"
                           " understood: axis, m_axi, s_axilite, ap_none, ap_vld are")  # fmt: skip
    lite = control.get("mode") == "s_axilite"
    if lite:
        bundles.setdefault(control.get("bundle", "control"), [])
        yield "interrupt", OUT, 1
    elif control.get("mode", "ap_ctrl_hs") != "ap_ctrl_none":
        for name, direction in (("ap_start", IN), ("ap_done", OUT), ("ap_idle", OUT), ("ap_ready", OUT)):
            yield name, direction, 1
    for bundle, args in bundles.items():
        yield from _lite(bundle, lite_bits(args))
    for bundle, width in masters.items():
        yield from _master(bundle, width)


def _plain(function: _Function, arg: Arg) -> Iterator[tuple[str, PortDirection, int]]:
    """A wire, with its valid signal if it is written (UG1399: ap_vld is the default for outputs)."""
    name = rtl_name(arg.name)
    if arg.indirect and arg.reads and arg.writes:
        text = "is read and written through a wire of its own: give it s_axilite, or two arguments"
        raise HdlError(f"{function.file}:{function.line}: argument {arg.name} {text}")
    output = arg.indirect and arg.writes
    yield name, OUT if output else IN, arg.width
    if (output and arg.mode == "") or arg.mode == "ap_vld":
        yield f"{name}_ap_vld", OUT if output else IN, 1


def _stream(name: str, packet: Packet, direction: PortDirection) -> Iterator[tuple[str, PortDirection, int]]:
    back = OUT if direction is IN else IN
    width = 8 * -(-packet.data // 8)
    yield f"{name}_TDATA", direction, width
    yield f"{name}_TVALID", direction, 1
    yield f"{name}_TREADY", back, 1
    if packet.sideband:
        yield from ((f"{name}_{signal}", direction, width // 8) for signal in ("TKEEP", "TSTRB"))
        for signal, bits in (("TUSER", packet.user), ("TLAST", 1), ("TID", packet.id), ("TDEST", packet.dest)):
            if bits:
                yield f"{name}_{signal}", direction, bits


def _lite(bundle: str, bits: int) -> Iterator[tuple[str, PortDirection, int]]:
    for signal, direction, width in (
        *(("AWVALID", IN, 1), ("AWREADY", OUT, 1), ("AWADDR", IN, bits), ("WVALID", IN, 1), ("WREADY", OUT, 1)),
        *(("WDATA", IN, 32), ("WSTRB", IN, 4), ("ARVALID", IN, 1), ("ARREADY", OUT, 1), ("ARADDR", IN, bits)),
        *(("RVALID", OUT, 1), ("RREADY", IN, 1), ("RDATA", OUT, 32), ("RRESP", OUT, 2)),
        *(("BVALID", OUT, 1), ("BREADY", IN, 1), ("BRESP", OUT, 2)),
    ):
        yield f"s_axi_{bundle}_{signal}", direction, width


def _master(bundle: str, width: int) -> Iterator[tuple[str, PortDirection, int]]:
    address = [("VALID", OUT, 1), ("READY", IN, 1), ("ADDR", OUT, 64), ("ID", OUT, 1), ("LEN", OUT, 8)]
    address += [("SIZE", OUT, 3), ("BURST", OUT, 2), ("LOCK", OUT, 2), ("CACHE", OUT, 4), ("PROT", OUT, 3)]
    address += [("QOS", OUT, 4), ("REGION", OUT, 4), ("USER", OUT, 1)]
    channels = {"AW": address, "AR": address}
    channels["W"] = [("VALID", OUT, 1), ("READY", IN, 1), ("DATA", OUT, width), ("STRB", OUT, width // 8)]
    channels["W"] += [("LAST", OUT, 1), ("ID", OUT, 1), ("USER", OUT, 1)]
    channels["R"] = [("VALID", IN, 1), ("READY", OUT, 1), ("DATA", IN, width), ("LAST", IN, 1), ("ID", IN, 1)]
    channels["R"] += [("USER", IN, 1), ("RESP", IN, 2)]
    channels["B"] = [("VALID", IN, 1), ("READY", OUT, 1), ("RESP", IN, 2), ("ID", IN, 1), ("USER", IN, 1)]
    for channel, signals in channels.items():
        for signal, direction, bits in signals:
            yield f"m_axi_{bundle}_{channel}{signal}", direction, bits


def hls_registers(spec: HlsSpec, top: str | None) -> dict[str, RegisterSpec]:
    """Registers by argument; the control register is ``ap_ctrl``, if the function is started by one.

    Arguments of more than 32 bits have a register for each word, ``NAME_0`` and so on.
    """
    function = _function(spec, top)
    control = function.pragmas.get("return", {})
    args = [a for a in function.args if a.mode == "s_axilite" or (a.mode == "m_axi" and a.said.get("offset") != "off")]
    found: dict[str, RegisterSpec] = {}
    if control.get("mode") == "s_axilite":
        doc = "start 1, done 2, idle 4, ready 8, restart 0x80"
        found["ap_ctrl"] = RegisterSpec("ap_ctrl", 0, volatile=True, doc=doc)
    for place in places(args):
        words = -(-place.bits // 32)
        for word in range(words):
            name = (f"{place.name}_{word}" if words > 1 else place.name).lower()
            access = Access.RO if place.output else Access.RW
            found[name] = RegisterSpec(name, place.offset + 4 * word, access=access, volatile=place.output)
    return found
