# SPDX-License-Identifier: Apache-2.0
"""Device trees that imitate those of stock images: mainline's tree of each board, out of Debian's kernel source, and
what matters of the image beside it, in our own words.

What the images add was read in their public sources: Xilinx/PYNQ v3.0.1 and v3.1 (`fabric`, FPGA_MANAGER=1) and
Xilinx/Kria-PYNQ (the same by an overlay); device-tree-xlnx (a generated pl.dtsi). `SOURCE_PACKAGE` is 150 MB and is
fetched by apt, once; LINUX names an unpacked source instead.
"""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass
from pathlib import Path

SOURCE_PACKAGE = "linux-source-6.12"
_PARTS = (
    "arch/arm/boot/dts",
    "arch/arm64/boot/dts/xilinx",
    "include/dt-bindings",
    "include/uapi/linux/input-event-codes.h",
)
_ZYNQ, _ZYNQMP = "arch/arm/boot/dts/xilinx", "arch/arm64/boot/dts/xilinx"


@dataclass(frozen=True, slots=True)
class Image:
    """A tree: mainline's `source`, an `overlay` of it, what the image adds, and whether it was built with -@."""

    source: str
    overlay: str = ""
    adds: str = ""
    symbols: bool = True


def fabric(address: int, cells: str, controller: str, spi: int) -> str:
    """The window and the interrupt that PYNQ's images give to UIO."""
    place = f"interrupt-parent = <&{controller}>; interrupts = <0 {spi} 4>;"
    return f'/ {{ fabric@{address:x} {{ compatible = "generic-uio"; reg = <{cells}>; {place} }}; }};'


def kept_pl(address: int, cells: int, controller: str, spi: int, clock: str) -> str:
    """A DMA of a PL that was left in the image's tree, as generated trees have it."""
    wide = "0 " if cells == 2 else ""
    return f"""/ {{ amba_pl: amba_pl {{
        #address-cells = <{cells}>; #size-cells = <{cells}>; compatible = "simple-bus"; ranges;
        dma@{address:x} {{
            #dma-cells = <1>; compatible = "xlnx,axi-dma-7.1", "xlnx,axi-dma-1.00.a";
            reg = <{wide}{address:#x} {wide}0x10000>; xlnx,addrwidth = <32>;
            clock-names = "s_axi_lite_aclk", "m_axi_sg_aclk", "m_axi_mm2s_aclk";
            clocks = <{clock}>, <{clock}>, <{clock}>;
            dma-channel@{address:x} {{
                compatible = "xlnx,axi-dma-mm2s-channel"; xlnx,datawidth = <32>;
                interrupt-parent = <&{controller}>; interrupts = <0 {spi} 4>;
            }};
        }};
    }}; }};"""


ZYBO, ZC702, ZCU104 = f"{_ZYNQ}/zynq-zybo-z7.dts", f"{_ZYNQ}/zynq-zc702.dts", f"{_ZYNQMP}/zynqmp-zcu104-revC.dts"
K26 = f"{_ZYNQMP}/zynqmp-smk-k26-revA.dts"
_KV = f"{_ZYNQMP}/zynqmp-sck-kv-g-revB.dtso"
_PYNQ_7000 = fabric(0x40000000, "0x40000000 0x10000", "intc", 29)
_PYNQ_MP = fabric(0xA0000000, "0 0xa0000000 0 0x10000", "gic", 89)

IMAGES = {
    "zybo-z7": Image(ZYBO),
    "zybo-z7-pl-kept": Image(ZYBO, adds=kept_pl(0x44000000, 1, "intc", 30, "&clkc 15")),
    "pynq-z2": Image(ZC702, adds=_PYNQ_7000),
    "zcu104": Image(ZCU104),
    "zcu104-debian": Image(ZCU104, symbols=False),  # the kernel's Makefile gives -@ to trees with overlays of their own
    "zcu104-pynq": Image(ZCU104, adds=_PYNQ_MP),
    "zcu104-pl-kept": Image(ZCU104, adds=kept_pl(0xA4000000, 2, "gic", 91, "&zynqmp_clk 71")),
    "kv260": Image(K26, _KV),
    "kv260-pynq": Image(K26, _KV, adds=_PYNQ_MP),
    "kr260": Image(K26),  # mainline has no tree of its carrier, whose nodes are of the PS alone
    "kr260-pynq": Image(K26, adds=_PYNQ_MP),
}


def linux(cache: Path) -> Path:
    """The part of a kernel source that trees need. Raises subprocess.CalledProcessError without a network."""
    if found := os.environ.get("LINUX"):
        return Path(found)
    place, work = cache / SOURCE_PACKAGE, cache / "fetched"
    if not place.exists():
        work.mkdir(parents=True, exist_ok=True)
        _run(["apt-get", "download", "-q", SOURCE_PACKAGE], work)
        (package,) = work.glob(f"{SOURCE_PACKAGE}_*.deb")
        wanted = " ".join(f"'*/{part}'" for part in _PARTS)
        (work / "tree").mkdir(exist_ok=True)
        packed = f"dpkg-deb --fsys-tarfile {package.name} | tar -xO ./usr/src/{SOURCE_PACKAGE}.tar.xz"
        _run(["sh", "-ec", f"{packed} | tar -xJ -C tree --strip-components=1 --wildcards {wanted}"], work)
        (work / "tree").rename(place)
        package.unlink()
    return place


def build(image: Image, source: Path, out: Path) -> Path:
    """The .dtb of an image at `out`."""
    tree = _compile(
        f'#include "{(source / image.source).name}"\n{image.adds}', image.source, source, out, image.symbols
    )
    if image.overlay:
        top = _compile(f'#include "{Path(image.overlay).name}"', image.overlay, source, out.with_suffix(".dtbo"))
        _run(["fdtoverlay", "-i", tree, "-o", tree, top])
    return tree


def _compile(text: str, name: str, source: Path, out: Path, symbols: bool = True) -> Path:
    include = [source / Path(name).parent, source / "include"]
    flags = [part for folder in include for part in ("-I", folder)]
    whole = _run(["cpp", "-nostdinc", "-undef", "-D__DTS__", "-x", "assembler-with-cpp", "-P", *flags, "-"], text=text)
    _run(["dtc", *(["-@"] if symbols else []), "-q", "-q", "-I", "dts", "-O", "dtb", "-o", out, "-"], text=whole)
    return out


def _run(command: list[str | Path], folder: Path | None = None, text: str | None = None) -> str:
    return subprocess.run(
        [str(part) for part in command], cwd=folder, input=text, capture_output=True, text=True, check=True
    ).stdout
