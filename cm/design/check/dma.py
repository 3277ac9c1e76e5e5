# SPDX-License-Identifier: Apache-2.0
"""Parameters of DMA engines: which exist, and which values they may have.

Sources of the ranges, read on docs.amd.com unless another place is named:

- length register: PG021 7.1, "S2MM_LENGTH": 8 to 26 bits; of an MCDMA 8 to 26 by ``xlnx,sg-length-width`` of the
  kernel's binding (xilinx_dma.txt), which its driver reads for both;
- widths of AXI DMA: PG021 7.1, "Features", as readers quote it (memory 32 to 1024 bits, streams 8 to 1024 bits, powers
  of two, realignment of streams up to 512 bits); of a VDMA: product page, PG020 6.3, AR 54934 (memory the same, streams
  any number of bytes up to 1024 bits, none wider than memory, realignment up to 64 bits);
- frame stores: PG020 6.3, "Frame Buffers": 32, with more than 32 bits of address 8; genlock, frame sync and depth of
  the line buffer: values that public designs set (0 to 3; 0 to 2; powers of two), no page of them was found;
- channels of an MCDMA: the kernel's binding, "up to 16 independent transmit and receive channels"; groups as 16 binary
  digits: designs with 2, 4 and 16 channels, which set those of their channels;
- read-only parameters: BD 41-737, reported for ``c_s_axis_s2mm_tdata_width`` of axi_vdma (Vivado 2025.2) and
  ``c_prmry_is_aclk_async`` of axi_dma; parameters that do not exist: BD 41-1276, for ``c_s2mm_fsync`` of axi_vdma.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from cm.design.plan.dma_cells import DmaCell
from cm.design.plan.dma_engines import MC_CHANNELS, EngineKind
from cm.design.project.source_position import Finding
from cm.schema.problems import KeyPath

_POWERS = tuple(1 << n for n in range(3, 11))  # 8 to 1024
_MEMORY = _POWERS[2:]
_FLAG = (0, 1)
_WAYS = ("mm2s", "s2mm")
Allowed = tuple[object, ...]


def _common() -> dict[str, Allowed]:
    found: dict[str, Allowed] = {"c_addr_width": tuple(range(32, 65)), "c_include_sg": _FLAG}
    for way in _WAYS:
        found |= {f"c_include_{way}": _FLAG, f"c_include_{way}_dre": _FLAG, f"c_m_axi_{way}_data_width": _MEMORY}
    return found


_SCATTER: dict[str, Allowed] = {
    "c_sg_include_stscntrl_strm": _FLAG,
    "c_sg_length_width": tuple(range(8, 27)),
}
_GROUPS = tuple(f"{(1 << count) - 1:016b}" for count in range(1, MC_CHANNELS + 1))
_PARAMETERS: Mapping[EngineKind, Mapping[str, Allowed]] = {
    EngineKind.DMA: _common() | _SCATTER | {"c_m_axis_mm2s_tdata_width": _POWERS, "c_s_axis_s2mm_tdata_width": _POWERS},
    EngineKind.MCDMA: _common()
    | _SCATTER
    | {"c_m_axis_mm2s_tdata_width": _POWERS}
    | {f"c_num_{way}_channels": tuple(range(1, MC_CHANNELS + 1)) for way in _WAYS}
    | {f"c_group1_{way}": _GROUPS for way in _WAYS},
    EngineKind.VDMA: _common()
    | {"c_m_axis_mm2s_tdata_width": tuple(range(8, 1025, 8)), "c_num_fstores": tuple(range(1, 33))}
    | {f"c_{way}_genlock_mode": (0, 1, 2, 3) for way in _WAYS}
    | {f"c_{way}_linebuffer_depth": (128, 256, 512, 1024, 2048, 4096, 8192, 16384, 32768, 65536) for way in _WAYS}
    | {"c_use_s2mm_fsync": (0, 1, 2)},
}
_READ_ONLY: Mapping[EngineKind, tuple[str, ...]] = {
    EngineKind.DMA: ("c_prmry_is_aclk_async",),
    EngineKind.MCDMA: ("c_prmry_is_aclk_async",),
    EngineKind.VDMA: ("c_prmry_is_aclk_async", "c_s_axis_s2mm_tdata_width"),
}
MAX_DRE = {EngineKind.DMA: 512, EngineKind.MCDMA: 512, EngineKind.VDMA: 64}


def check_dma(dma: DmaCell) -> Iterator[Finding]:
    """Findings of one engine."""
    for name, value in dma.settings:
        yield from _parameter(dma, name, value)
    values = dict(dma.settings)
    for way in _WAYS:
        for rule in (_narrow_memory, _realignment, _channels):
            yield from rule(dma, values, way)
    if dma.ip is EngineKind.VDMA:
        yield from _frames(dma, values)


def _finding(dma: DmaCell, message: str, hint: str = "", rule: str = "") -> Finding:
    key: KeyPath = ("regions",)
    return Finding(rule or dma.ip.guide, key, f"{dma.cell}{message}", hint)


def _parameter(dma: DmaCell, name: str, value: object) -> Iterator[Finding]:
    allowed = _PARAMETERS[dma.ip].get(name)
    if name in _READ_ONLY[dma.ip]:
        yield _finding(dma, f": {name} is read-only", "the core takes it from what it is connected to", "BD 41-737")
    elif allowed is None:
        yield _finding(dma, f" has no parameter {name}")
    elif value not in allowed:
        text = f"{allowed[0]} to {allowed[-1]}" if len(allowed) > 8 else ", ".join(map(str, allowed))
        yield _finding(dma, f": {name} is {value}", f"it may be {text}")


def _stream(dma: DmaCell, values: Mapping[str, object], way: str) -> int:
    """Bits of a stream, from the parameter or its port."""
    pin = "M_AXIS_MM2S" if way == "mm2s" else "S_AXIS_S2MM"
    own = values.get(f"c_{pin.lower()}_tdata_width")
    ports = [dict(port.settings).get("TDATA_NUM_BYTES") for port in dma.ports if port.pin == pin]
    given = own if own is not None else next((8 * size for size in ports if isinstance(size, int)), 0)
    return given if isinstance(given, int) else 0


def _narrow_memory(dma: DmaCell, values: Mapping[str, object], way: str) -> Iterator[Finding]:
    stream, memory = _stream(dma, values, way), values.get(f"c_m_axi_{way}_data_width")
    if isinstance(memory, int) and stream > memory:
        message = f": the stream has {stream} bits, the way to memory {memory}"
        yield _finding(dma, message, "memory is at least as wide as the stream")


def _realignment(dma: DmaCell, values: Mapping[str, object], way: str) -> Iterator[Finding]:
    if values.get(f"c_include_{way}_dre") == 1 and _stream(dma, values, way) > MAX_DRE[dma.ip]:
        message = f": c_include_{way}_dre with a stream of {_stream(dma, values, way)} bits"
        yield _finding(dma, message, f"there is realignment up to {MAX_DRE[dma.ip]} bits")


def _channels(dma: DmaCell, values: Mapping[str, object], way: str) -> Iterator[Finding]:
    count, group = values.get(f"c_num_{way}_channels"), str(values.get(f"c_group1_{way}", ""))
    if count is not None and re.fullmatch(r"[01]{16}", group) and group.count("1") != count:
        message = f": c_group1_{way} has {group.count('1')} channels, c_num_{way}_channels says {count}"
        yield _finding(dma, message, "a channel in no group is never served")


def _frames(dma: DmaCell, values: Mapping[str, object]) -> Iterator[Finding]:
    address, frames = values.get("c_addr_width"), values.get("c_num_fstores")
    if isinstance(address, int) and isinstance(frames, int) and address > 32 and frames > 8:
        yield _finding(dma, f": {frames} frame stores with {address} bits of address", "there are at most 8 then")
