# SPDX-License-Identifier: Apache-2.0
"""The boards there are: which kernel, which machine, and what each must be able to do."""

from __future__ import annotations

from dataclasses import dataclass, replace

from vmboard import kernel
from vmboard.arch import AMD64, ARM64, ARMHF, ARMMP, Arch
from vmboard.cache import Cache
from vmboard.silicon import Source


@dataclass(frozen=True, slots=True)
class Tier:
    """One virtual board; a capability in `expects` that is missing on it is a failure, not a skip.

    `slow` is how many times slower than a board of silicon it may be. Every time-out of the tests, here and on the
    board, is multiplied by it, and nothing else is: with KVM it is 1.
    """

    name: str
    arch: Arch
    fragments: tuple[str, ...]  # none: Debian's own kernel
    expects: tuple[str, ...]
    memory_mb: int
    slow: int
    changes: int = 100  # of mode in a row
    kvm: bool = False  # where the host's works; emulated otherwise
    append: str = ""  # more arguments of the kernel
    remote: bool = False  # tests run on the host and talk to the board over TCP
    dtb: str = "qemu-virt"  # tree, where the kernel is our own
    machine: str = ""  # more properties of QEMU's machine
    installed: bool = False  # a whole Debian, where our packages are installed; tests run on the host
    suite: str = ""  # of Debian, whose kernel it is, where it is not the host's
    optional: bool = False  # only where it is asked for by name
    static: str = "static"  # overlay of the board's own engines, where the kernel takes overlays
    designs: str = "camera-kv260"  # of designs.py, that its memory map has room for
    driver: Source | None = None  # of the engines, of another kernel
    cases: tuple[str, ...] = ("vm/cases", "device")  # what is run there, below tests/

    def kernel(self, cache: Cache) -> kernel.Kernel:
        """Build or fetch the kernel."""
        if self.fragments:
            return kernel.custom(cache, self.arch, self.fragments)
        return kernel.stock(cache, self.arch, self.suite)


BASIC = ("cm", "dma", "uio", "plsim")
FULL = (*BASIC, "overlay", "fpga", "uio_genirq", "kunit")
SANITIZERS = ("kasan", "lockdep", "dma_debug")
DEBIAN = (*BASIC, "suspend")  # what Debian's kernel has more than ours
CUSTOM = ("custom.config",)
SANITIZE = (*CUSTOM, "sanitize.config")
SILICON_CASES = ("silicon", "polled", "generated", "shared", "overlays", "board", "manager")
SILICON = Tier(
    "silicon",
    ARM64,
    SANITIZE,
    (*BASIC, "overlay", "fpga", "uio_genirq", *SANITIZERS, "xilinx_dma"),
    memory_mb=2048,  # from 768 MB on it stands for what is in the PL
    slow=12,
    changes=20,
    append="mem=768M",
    dtb="qemu-zynqmp",
    machine="virtualization=on",  # for the platform firmware's model, at EL2
    static="silicon",
    designs="camera-kv260+camera-kv260-coherent",
    cases=(*(f"vm/cases/test_{name}.py" for name in SILICON_CASES), "device"),
)
ENGINES = (*(f"vm/cases/test_{name}.py" for name in ("silicon", "polled", "generated", "shared")), "device")
ZYNQ = Tier(
    "zynq",
    ARMHF,
    (*CUSTOM, "zynq.config"),
    (*BASIC, "overlay", "fpga", "uio_genirq", "xilinx_dma", "zynq"),
    memory_mb=1280,  # what is behind M_AXI_GP0, from 1 GB on, is in the PL
    slow=12,
    changes=20,
    append="mem=512M",
    static="configfs",
    designs="camera-pynq-z2",
    cases=(*(f"vm/cases/test_{name}.py" for name in ("zynq", "generated", "manager")), "device"),
)
TIERS = {
    tier.name: tier
    for tier in (
        Tier("stock", ARM64, (), DEBIAN, memory_mb=768, slow=6),
        Tier("stock-trixie", ARM64, (), DEBIAN, memory_mb=768, slow=6, suite="trixie", optional=True),
        Tier("stock-sid", ARM64, (), DEBIAN, memory_mb=768, slow=6, suite="sid", optional=True),
        Tier(  # its CMA area is in high memory, of which the kernel gives no cached pages
            "stock-armhf",
            ARMMP,
            (),
            (*BASIC, "highmem"),
            memory_mb=1024,
            slow=6,
            append="cma=128M",
            suite="trixie",
            optional=True,
            cases=("vm/cases/test_high_memory.py", "device"),
        ),
        Tier(
            "custom",
            ARM64,
            SANITIZE,
            (*FULL, *SANITIZERS, "kmemleak"),
            memory_mb=1024,
            slow=12,
            changes=300,
            append="kmemleak=on",
        ),
        SILICON,
        replace(
            SILICON,
            name="silicon-6.12",
            driver=Source("trixie", "linux-source-6.12"),
            static="silicon-polled",  # the interrupts of its engines are connected to nothing
            cases=ENGINES,
        ),
        ZYNQ,
        Tier("remote", ARM64, SANITIZE, FULL, memory_mb=768, slow=12, remote=True),
        Tier("service", ARM64, (), (), memory_mb=1024, slow=6, installed=True),
        Tier("service-armhf", ARMMP, (), (), memory_mb=1024, slow=6, installed=True, optional=True),
        Tier("x86", AMD64, (), DEBIAN, memory_mb=768, slow=6, kvm=True),
    )
}
