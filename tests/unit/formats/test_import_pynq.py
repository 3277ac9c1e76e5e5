# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import pytest
from import_support import (
    bitstream,
    buses,
    described,
    hwh,
    memory,
    memory_range,
    module,
    port,
    ports,
    register,
    register_field,
    slot_overlay,
)

from cm.formats.bitstream import inspect
from cm.formats.bitstream.errors import BitstreamError
from cm.formats.hwh import HwhError
from cm.formats.importers import Imported, ImportRefused, import_pynq, write
from cm.schema import dump, load, loads
from cm.schema.model import Access, Block, Config, ConfigType, Decoupler, Direction, FrameRange, GpioLine, LoaderKind
from cm.schema.named_files import bitstream_path, overlay_path

PS = "processing_system7"
FILTER = described(
    register("CTRL", 0, register_field("AP_START", 0, 1), register_field("AP_DONE", 1, 1, "read-only")),
    register("rows", 0x10, access="write-only"),
    register("status", 0x14, access="read-only", RESET_VALUE="0x80"),
    register("ISR", 0x18, register_field("DONE", 0, 1, MODIFIED_WRITE_VALUE="oneToClear")),
    register("Memory_kernel", 0x40, size=16),
    register("odd", 0x21, size=24),
    register("narrow", 0x24, size=2),
    register("again", 0x10),
)


def design() -> bytes:
    """A filter, a DMA, a region behind a decoupler that a GPIO drives, an interrupt and a clock."""
    return hwh(
        module(
            "ps",
            PS,
            ports(port("IRQ_F2P", "I", ("filter", "interrupt"), kind="INTERRUPT")),
            memory(
                ("filter", 0x40000000, 0x10000),
                ("dma", 0x40400000, 0x10000),
                ("gpio", 0x41200000, 0x10000),
                ("pr_0", 0x43C00000, 0x10000),
                ("blob", 0x43D00000, 0x1000),
            ),
            parameters={"PCW_FPGA_FCLK0_ENABLE": "1", "PCW_ACT_FPGA0_PERIPHERAL_FREQMHZ": "100.0"},
        ),
        module("filter", "filter", FILTER),
        module("dma", "axi_dma", parameters={"C_INCLUDE_MM2S": "1", "C_INCLUDE_S2MM": "1"}),
        module("gpio", "axi_gpio"),
        module("blob", "custom"),
        module(
            "dec", "dfx_decoupler", ports(port("decouple", "I", ("gpio", "gpio_io_o")), port("rp", "I", ("pr_0", "x")))
        ),
        module("pr_0", "rm", region=True),
        module("pr_1", "rm", region=True),
    )


def partial_design() -> bytes:
    text = f"<BUSINTERFACE><MEMORYMAP>{memory_range('acc', 0, 0x1000)}</MEMORYMAP></BUSINTERFACE>"
    return hwh(module("acc", "acc", described(register("GAIN", 0x10))), external=text, design="rm_gain")


@pytest.fixture
def overlay(tmp_path: Path) -> Path:
    """A static design without partial bitstreams."""
    (tmp_path / "cam.bit").write_bytes(bitstream())
    (tmp_path / "cam.hwh").write_bytes(design())
    return tmp_path / "cam.bit"


@pytest.fixture
def dfx(overlay: Path) -> Path:
    """Two modules for region pr_0, one for a region that nothing names."""
    folder = overlay.parent / "partial"
    folder.mkdir()
    for name, column in (("pr_0_edge", 3), ("pr_0_zoom", 3), ("other", 9)):
        (folder / f"{name}.bit").write_bytes(bitstream(column))
        (folder / f"{name}.hwh").write_bytes(partial_design())
    return overlay


def static(imported: Imported) -> Config:
    return imported.configs[0]


def test_static_design_becomes_a_full_configuration(overlay: Path) -> None:
    config = static(import_pynq(overlay))
    assert (config.name, config.type, config.device) == ("cam", ConfigType.FULL, "xc7z020")
    assert config.sha256 == inspect(overlay).sha256


def test_registers_have_name_place_access_and_fields(overlay: Path) -> None:
    found = static(import_pynq(overlay)).registers
    control = found["filter_ctrl"]
    assert (control.address, control.width, control.access) == (0x40000000, 32, Access.RW)
    assert [(item.name, item.lsb) for item in control.fields.values()] == [("ap_start", 0), ("ap_done", 1)]
    assert control.volatile
    assert found["filter_rows"].access is Access.WO
    assert (found["filter_status"].access, found["filter_status"].reset) == (Access.RO, 0x80)
    assert found["filter_isr"].access is Access.W1C
    assert found["gpio_gpio_data"].address == 0x41200000
    assert found["filter_narrow"].width == 32  # two bits, but a whole word on the bus


def test_what_is_not_a_register_is_left_out_and_reported(overlay: Path) -> None:
    imported = import_pynq(overlay)
    assert "filter: no plain registers, left out: odd" in imported.notes
    assert "filter: at the address of another, whose doc names it: again" in imported.notes
    assert static(imported).registers["filter_rows"].doc == "The rows Same address: again."


def test_registers_of_drivers_are_left_out_and_reported(overlay: Path) -> None:
    imported = import_pynq(overlay)
    assert not any(name.startswith("dma") for name in static(imported).registers)
    assert any("dma (axi_dma) at 0x40400000" in note for note in imported.notes)
    assert any("blob (custom) at 0x43d00000" in note for note in imported.notes)


def test_channels_interrupts_and_clocks_are_carried_over(overlay: Path) -> None:
    config = static(import_pynq(overlay))
    assert {name: stream.direction for name, stream in config.streams.items()} == {
        "dma_mm2s": Direction.MM2S,
        "dma_s2mm": Direction.S2MM,
    }
    assert config.interrupts["filter_interrupt"].base_address == 0x40000000
    assert config.clocks["fclk0"].rate == 100_000_000


def bram_design(*ranges: str) -> bytes:
    """A design whose processor addresses a BRAM controller."""
    return hwh(module("ps", PS, f"<MEMORYMAP>{''.join(ranges)}</MEMORYMAP>"), module("bram", "axi_bram_ctrl"))


@pytest.mark.parametrize("kind", ["MEMORY", "REGISTER"])
def test_block_ram_becomes_a_memory(overlay: Path, kind: str) -> None:
    overlay.with_suffix(".hwh").write_bytes(bram_design(memory_range("bram", 0x40000000, 0x2000, kind)))
    imported = import_pynq(overlay)
    (block,) = static(imported).memories.values()
    assert (block.name, block.address, block.size, block.dtype) == ("bram", 0x40000000, 0x2000, "uint32")
    assert not any("bram" in note for note in imported.notes)


def test_the_registers_of_a_bram_controller_are_not_a_memory(overlay: Path) -> None:
    ecc = memory_range("bram", 0x40010000, 0x1000).replace('"S_AXI"', '"S_AXI_CTRL"')
    overlay.with_suffix(".hwh").write_bytes(bram_design(ecc))
    imported = import_pynq(overlay)
    assert not static(imported).memories
    assert any("bram" in note and "describes no registers" in note for note in imported.notes)


def test_block_ram_that_no_schema_can_have_is_left_out_and_reported(overlay: Path) -> None:
    overlay.with_suffix(".hwh").write_bytes(bram_design(memory_range("bram", 0x40000000, 0x8000_0000, "MEMORY")))
    imported = import_pynq(overlay)
    assert not static(imported).memories
    assert any("bram" in note and "left out" in note for note in imported.notes)


def test_block_ram_of_a_module_lies_in_its_regions_window(dfx: Path, tmp_path: Path) -> None:
    ranges = memory_range("table", 0x800, 0x400, "MEMORY") + memory_range("far", 0x20000, 0x400, "MEMORY")
    external = f"<BUSINTERFACE><MEMORYMAP>{ranges}</MEMORYMAP></BUSINTERFACE>"
    blocks = (module("table", "axi_bram_ctrl"), module("far", "axi_bram_ctrl"))
    text = hwh(*blocks, external=external, design="rm_edge")
    (dfx.parent / "partial" / "pr_0_edge.hwh").write_bytes(text)
    imported = import_pynq(dfx)
    (block,) = imported.configs[0].modules["pr_0_edge"].memories.values()
    assert (block.name, block.address, block.size, block.region) == ("pr_0_table", 0x43C00800, 0x400, "pr_0")
    assert any("far" in note and "left out" in note for note in imported.notes)
    write(imported, tmp_path / "out")
    assert load(tmp_path / "out" / f"{imported.configs[0].name}.yaml").modules["pr_0_edge"].memories


def test_overlay_beside_the_bitstream_is_used(overlay: Path) -> None:
    assert any("cam.dtbo: not there" in note for note in import_pynq(overlay).notes)
    overlay.with_suffix(".dtbo").write_bytes(slot_overlay(0, None))
    assert [item.file for item in static(import_pynq(overlay)).overlays] == [overlay.with_suffix(".dtbo")]


def test_partials_become_regions_and_modules(dfx: Path) -> None:
    """One configuration: what the static part has stays there when a module is loaded."""
    (config,) = import_pynq(dfx).configs
    assert (config.name, config.type) == ("cam", ConfigType.FULL)
    assert {"filter_ctrl"} <= config.visible_registers("pr_0_edge").keys()
    assert {name: item.region for name, item in config.modules.items()} == {
        "other": "prr2",
        "pr_0_edge": "pr_0",
        "pr_0_zoom": "pr_0",
    }
    assert config.modes["pr_0_edge"].modules == ("pr_0_edge",)
    assert config.regions["pr_0"].loader is LoaderKind.FPGA_MANAGER
    assert config.regions["pr_0"].footprint == (FrameRange(0, 0, 3, 3),)


def test_decoupler_of_a_region_is_found(dfx: Path) -> None:
    imported = import_pynq(dfx)
    assert imported.configs[0].regions["pr_0"].decoupler == Decoupler(base_address=0x41200000, offset=0, bit=0)
    assert any("region prr2: no decoupler" in note for note in imported.notes)


def test_decoupler_on_an_emio_pin_is_a_line_of_the_processors_gpio(dfx: Path) -> None:
    handoff = dfx.with_suffix(".hwh")
    wired = handoff.read_text(encoding="utf-8").replace(
        'INSTANCE="gpio" PORT="gpio_io_o"', 'INSTANCE="ps" PORT="GPIO_O"'
    )
    assert 'PORT="GPIO_O"' in wired
    handoff.write_text(wired, encoding="utf-8")
    imported = import_pynq(dfx)
    assert imported.configs[0].regions["pr_0"].decoupler == Decoupler(gpio=GpioLine("zynq_gpio", 54))
    assert not any("region pr_0" in note and "cut off" in note for note in imported.notes)


def test_registers_of_a_module_lie_in_its_regions_window(dfx: Path) -> None:
    found = import_pynq(dfx).configs[0].modules["pr_0_edge"].registers
    assert found["pr_0_acc_gain"].address == 0x43C00010
    assert found["pr_0_acc_gain"].region == "pr_0"


def test_absolute_addresses_in_a_modules_description_are_the_same_registers(dfx: Path) -> None:
    text = partial_design().decode().replace("0x00000000", "0x43C00000").replace("0x00000FFF", "0x43C00FFF")
    assert text != partial_design().decode()
    (dfx.parent / "partial" / "pr_0_edge.hwh").write_text(text)
    found = import_pynq(dfx).configs[0].modules["pr_0_edge"].registers
    assert found["pr_0_acc_gain"].address == 0x43C00010


def test_partial_whose_frames_are_elsewhere_is_left_out(dfx: Path) -> None:
    (dfx.parent / "partial" / "pr_0_zoom.bit").write_bytes(bitstream(20))
    imported = import_pynq(dfx)
    assert "pr_0_zoom" not in imported.configs[0].modules
    assert any(
        "pr_0_zoom.bit: left out: by its name for pr_0" in note and "column 20" in note for note in imported.notes
    )


def test_damaged_and_foreign_partials_are_left_out(dfx: Path) -> None:
    folder = dfx.parent / "partial"
    damaged = bytearray(bitstream(3))
    damaged[-100] ^= 1
    (folder / "pr_0_bad.bit").write_bytes(damaged)
    (folder / "pr_0_text.bit").write_bytes(b"text")
    (folder / "pr_0_small.bit").write_bytes(bitstream(3, device="xc7z010"))
    imported = import_pynq(dfx)
    assert set(imported.configs[0].modules) == {"pr_0_edge", "pr_0_zoom", "other"}
    assert sum("left out" in note and "pr_0_bad" in note for note in imported.notes) == 1
    assert any("pr_0_text.bit: left out" in note for note in imported.notes)


def test_what_is_written_loads_and_finds_its_files(dfx: Path, tmp_path: Path) -> None:
    imported = import_pynq(dfx)
    files = write(imported, tmp_path)
    assert [path.name for path in files] == ["cam.yaml"]
    config = load(files[0])
    assert bitstream_path(config, None) == tmp_path / "cam.bit"
    assert bitstream_path(config, "pr_0_edge") == tmp_path / "partial" / "pr_0_edge.bit"
    assert config.modules["pr_0_edge"].bitstream == Path("partial/pr_0_edge.bit")  # moves with the package
    assert config.registers == imported.configs[0].registers
    assert set(config.streams_in("pr_0_edge", {})) == {"dma_mm2s", "dma_s2mm"}


def test_schema_written_elsewhere_still_finds_the_package(overlay: Path, tmp_path: Path) -> None:
    overlay.with_suffix(".dtbo").write_bytes(slot_overlay(0, None))
    (path,) = write(import_pynq(overlay), tmp_path / "elsewhere")
    config = load(path)
    assert bitstream_path(config, None) == overlay
    assert overlay_path(config, config.overlays[0]) == overlay.with_suffix(".dtbo")


def test_partial_in_place_of_the_static_design_is_refused(dfx: Path) -> None:
    with pytest.raises(ImportRefused, match=r"partial bitstream; give the \.bit of its static design"):
        import_pynq(dfx.parent / "partial" / "pr_0_edge.bit")


def test_overlay_without_handoff_is_refused(overlay: Path) -> None:
    overlay.with_suffix(".hwh").unlink()
    overlay.with_suffix(".tcl").write_text("")
    with pytest.raises(ImportRefused, match=r"cam\.hwh: not there.*\.tcl is not read"):
        import_pynq(overlay)


def test_handoff_of_another_device_is_refused(overlay: Path) -> None:
    overlay.with_suffix(".hwh").write_bytes(hwh(device="7z010"))
    with pytest.raises(ImportRefused, match="of 7z010, the bitstream of xc7z020"):
        import_pynq(overlay)


def test_damaged_files_are_refused_by_their_readers(overlay: Path) -> None:
    overlay.with_suffix(".hwh").write_bytes(b"<")
    with pytest.raises(HwhError):
        import_pynq(overlay)
    overlay.write_bytes(overlay.read_bytes()[:-40])
    with pytest.raises(BitstreamError):
        import_pynq(overlay)


def test_the_static_designs_user_id_goes_into_the_configuration(dfx: Path) -> None:
    assert [config.static for config in import_pynq(dfx).configs] == [None]
    dfx.write_bytes(dfx.read_bytes().replace(b"UserID=0XFFFFFFFF", b"UserID=0X00C0FFEE"))
    found = import_pynq(dfx).configs
    assert [config.static.user_id for config in found if config.static] == [0xC0FFEE]


@pytest.mark.parametrize("data", [b"", b"<html>404</html>"], ids=["empty", "a page"])
def test_an_overlay_that_is_no_device_tree_is_left_out_with_a_note(overlay: Path, data: bytes) -> None:
    overlay.with_suffix(".dtbo").write_bytes(data)
    imported = import_pynq(overlay)
    assert not static(imported).overlays
    assert any(note.startswith("cam.dtbo: left out: no whole flattened device tree") for note in imported.notes)


def wired(
    *modules: str, interrupts: tuple[tuple[str, str], ...] = (), windows: tuple[tuple[str, int, int], ...]
) -> bytes:
    """A design with these modules, of which some interrupts reach the processor, each by a bit."""
    joined = [port("dout", "O", ("ps", "IRQ_F2P"), bits=max(len(interrupts), 1))]
    joined += [port(f"In{number}", "I", end) for number, end in enumerate(interrupts)]
    lines = ports(port("IRQ_F2P", "I", ("join", "dout"), kind="INTERRUPT", bits=max(len(interrupts), 1)))
    return hwh(module("ps", PS, lines, memory(*windows)), module("join", "xlconcat", ports(*joined)), *modules)


def imported_design(folder: Path, text: bytes) -> Imported:
    (folder / "cam.bit").write_bytes(bitstream())
    (folder / "cam.hwh").write_bytes(text)
    return import_pynq(folder / "cam.bit")


def test_a_dma_whose_interrupt_is_unconnected_is_named_with_what_that_means(tmp_path: Path) -> None:
    text = wired(
        module("dma", "axi_dma"),
        interrupts=(("dma", "mm2s_introut"),),
        windows=(("dma", 0x40400000, 0x10000),),
    )
    notes = [note for note in imported_design(tmp_path, text).notes if "introut" in note]
    assert notes == [
        "stream dma_s2mm: s2mm_introut of dma is connected to nothing (PYNQ polls): the module cm_intc looks for the "
        "end of transfers, where the overlay has a node for it, as the one that the import makes"
    ]


def test_interrupts_of_known_blocks_have_status_and_acknowledgement(tmp_path: Path) -> None:
    """So that a level does not come again and again."""
    toggled = register_field("CHAN0_INT_ST", 0, 1, "read-only", MODIFIED_READ_VALUES="oneToToggle")
    text = wired(
        module("gpio", "axi_gpio"), module("timer", "axi_timer"),
        module("cnn", "cnn", described(register("IP_ISR", 12, toggled))),
        interrupts=(("gpio", "ip2intc_irpt"), ("timer", "interrupt"), ("cnn", "interrupt")),
        windows=(("gpio", 0x41200000, 0x1000), ("timer", 0x42800000, 0x1000), ("cnn", 0x43C00000, 0x1000)),
    )  # fmt: skip
    config = static(imported_design(tmp_path, text))
    assert {name: (line.status, line.bit, line.acknowledge) for name, line in config.interrupts.items()} == {
        "gpio_ip2intc_irpt": ("gpio_ip_isr", 0, True), "gpio_ip2intc_irpt_2": ("gpio_ip_isr", 1, True),
        "timer_interrupt": ("timer_tcsr0", 8, True), "timer_interrupt_2": ("timer_tcsr1", 8, True),
        "cnn_interrupt": ("cnn_ip_isr", 0, True),
    }  # fmt: skip
    write(import_pynq(tmp_path / "cam.bit"), tmp_path / "out")


def test_a_constant_is_no_interrupt(tmp_path: Path) -> None:
    text = wired(module("GND_1", "xlconstant"), interrupts=(("GND_1", "dout"),), windows=())
    imported = imported_design(tmp_path, text)
    assert not static(imported).interrupts
    assert not any("GND_1" in note for note in imported.notes)


def test_a_block_without_described_registers_is_a_memory_of_its_name(tmp_path: Path) -> None:
    text = wired(module("blob", "custom"), windows=(("blob", 0x43D00000, 0x1000),))
    blob = static(imported_design(tmp_path, text)).memories["blob"]
    assert (blob.address, blob.size, blob.dtype) == (0x43D00000, 0x1000, "uint32")


def test_the_window_of_a_decoupler_is_left_to_the_manager(tmp_path: Path) -> None:
    text = wired(module("dec", "dfx_decoupler"), windows=(("dec", 0x43D00000, 0x1000),))
    imported = imported_design(tmp_path, text)
    assert not static(imported).memories
    assert any(note.startswith("dec (dfx_decoupler) at 0x43d00000") for note in imported.notes)


def test_names_of_channels_that_are_too_long_are_cut_without_a_clash(tmp_path: Path) -> None:
    names = [f"video_pipeline_with_a_long_name_{side}" for side in ("left", "right")]
    text = wired(*(module(name, "axi_dma") for name in names), windows=())
    streams = static(imported_design(tmp_path, text)).streams
    assert len(streams) == 4
    assert all(len(name) <= 31 for name in streams)


def test_a_handoff_of_another_version_or_design_is_named(tmp_path: Path) -> None:
    said = [note for note in imported_design(tmp_path, wired(windows=())).notes if "belong together" in note]
    assert said == ["cam.bit is of cm_assembled, the .hwh of top: they may not belong together"]
    (tmp_path / "cam.bit").write_bytes(
        bitstream().replace(b"*cm_assembled", b".cm_assembled").replace(b"=cm", b"=2019.1")
    )
    said = [note for note in import_pynq(tmp_path / "cam.bit").notes if "belong together" in note]
    assert said == ["cam.bit was made by Vivado 2019.1, the .hwh by 2022.1: they may not belong together"]


def test_a_clock_in_exponent_form_is_a_clock(tmp_path: Path) -> None:
    given = {"PCW_FPGA_FCLK0_ENABLE": "1", "PCW_ACT_FPGA0_PERIPHERAL_FREQMHZ": "1e+02"}
    pin = '<PORTS><PORT CLKFREQUENCY="1e+08" DIR="O" NAME="FCLK_CLK0" SIGIS="clk"/></PORTS>'
    config = static(imported_design(tmp_path, hwh(module("ps", PS, pin, parameters=given))))
    assert {name: clock.rate for name, clock in config.clocks.items()} == {"fclk0": 100_000_000}


def test_a_block_has_its_window_interrupts_and_streams_and_says_where_its_own_lead(tmp_path: Path) -> None:
    design = hwh(
        module(
            "ps",
            "processing_system7",
            ports(port("IRQ_F2P", "I", ("gpio", "ip2intc_irpt"), kind="INTERRUPT")),
            memory(("dma", 0x40400000, 0x10000), ("gpio", 0x41200000, 0x10000)),
        ),
        module("dma", "axi_dma", buses(("M_AXIS_MM2S", "MASTER", "a"), ("S_AXIS_S2MM", "SLAVE", "b"))),
        module("fifo", "axis_data_fifo", buses(("S_AXIS", "SLAVE", "a"), ("M_AXIS", "MASTER", "b"))),
        module("gpio", "axi_gpio", ports(port("ip2intc_irpt", "O", ("ps", "IRQ_F2P"), kind="INTERRUPT"))),
    )
    (tmp_path / "loop.bit").write_bytes(bitstream())
    (tmp_path / "loop.hwh").write_bytes(design)
    [config] = import_pynq(tmp_path / "loop.bit").configs
    irqs = ("gpio_ip2intc_irpt", "gpio_ip2intc_irpt_2")
    assert list(config.blocks.values()) == [
        Block("dma", 0x40400000, 0x10000, "xilinx.com:ip:axi_dma:1.0", "dma_", (), ("dma_mm2s", "dma_s2mm"), ("fifo",)),
        Block("fifo", vlnv="xilinx.com:ip:axis_data_fifo:1.0", peers=("dma_s2mm",)),
        Block("gpio", 0x41200000, 0x10000, "xilinx.com:ip:axi_gpio:1.0", "gpio_", irqs),
    ]
    assert loads(dump(config), Path("loop.yaml")).blocks == config.blocks


def test_the_interrupts_of_an_i2c_controller_are_told_apart_and_acknowledged(tmp_path: Path) -> None:
    status = (register_field(f"int{bit}", bit, 1, MODIFIED_READ_VALUES="oneToToggle") for bit in range(8))
    design = hwh(
        module(
            "ps",
            "processing_system7",
            ports(port("IRQ_F2P", "I", ("iic", "iic2intc_irpt"), kind="INTERRUPT")),
            memory(("iic", 0x41600000, 0x10000)),
        ),
        module(
            "iic",
            "axi_iic",
            described(register("ISR", 0x20, *status)),
            ports(port("iic2intc_irpt", "O", ("ps", "IRQ_F2P"), kind="INTERRUPT")),
        ),
    )
    (tmp_path / "i.bit").write_bytes(bitstream())
    (tmp_path / "i.hwh").write_bytes(design)
    [config] = import_pynq(tmp_path / "i.bit").configs
    found = config.interrupts.values()
    assert [(one.status, one.bit, one.acknowledge) for one in found] == [("iic_isr", bit, True) for bit in range(8)]
