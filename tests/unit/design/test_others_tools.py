# SPDX-License-Identifier: Apache-2.0
"""What tools of this field really write, where a good guess about them is wrong: run, and read by ours.

`findings/` shows the same without us. Versions are those of the extra [test-design] and of Debian 12.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from build_support import MINIMAL, needs, project

from cm.cli.main import main
from cm.design.generate.generation import generate, load_design, output_folder
from cm.design.hdl.register_maps import read_register_map
from cm.formats.bitstream import Expectation, FrameAddress, FrameRun, assemble
from cm.manager.errors import BadOverlay
from cm.server.bitstream_and_overlay_files import BitstreamReader, checked_overlay

pytestmark = pytest.mark.design
SCRIPTS = Path(sysconfig.get_path("scripts"))


def run(folder: Path, *command: str | Path) -> str:
    done = subprocess.run([str(part) for part in command], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@needs("bootgen")
@pytest.mark.parametrize(("arch", "part"), [("zynq", "7z020clg400"), ("zynqmp", "xczu7ev-ffvc1156-2-e")])
def test_a_bin_of_bootgen_is_the_same_image_as_its_bit(arch: str, part: str, tmp_path: Path) -> None:
    """For a Zynq-7000 bootgen adds NOP words up to a multiple of 32 bytes."""
    device, frame = ("xc7z020", 404) if arch == "zynq" else ("xczu7ev", 372)
    whole = assemble(device, [FrameRun(FrameAddress(0, 0, 26), bytes(frame))], part=part)
    (tmp_path / "design.bit").write_bytes(whole)
    (tmp_path / "all.bif").write_text("all:\n{\n\tdesign.bit\n}\n")
    run(tmp_path, "bootgen", "-arch", arch, "-image", "all.bif", "-process_bitstream", "bin", "-w", "on")
    reader = BitstreamReader()
    image = reader.image(tmp_path / "design.bit", Expectation())
    assert reader.configures_as(tmp_path / "design.bit.bin", image)
    assert reader.has_words_of(tmp_path / "design.bit.bin", image) == (arch == "zynqmp")


@needs("dtc")
def test_an_overlay_that_lopper_wrote_as_source_has_lost_its_targets(tmp_path: Path) -> None:
    lopper = SCRIPTS / "lopper"
    if not lopper.exists():
        pytest.skip("needs lopper: the extra [test-design] is not installed")
    (tmp_path / "a.dtso").write_text("/dts-v1/; /plugin/; &fpga_pr0 { camera { clocks = <&clkc 15>; }; };")
    run(tmp_path, "dtc", "-q", "-@", "-O", "dtb", "-o", "a.dtb", "a.dtso")
    run(tmp_path, lopper, "-f", "a.dtb", "b.dts")
    run(tmp_path, "dtc", "-q", "-O", "dtb", "-o", "b.dtbo", "b.dts")
    assert checked_overlay("a.dtb", (tmp_path / "a.dtb").read_bytes())
    with pytest.raises(BadOverlay, match=r"b\.dtbo: fragment@0 has no target: __fixups__ names no label for it"):
        checked_overlay("b.dtbo", (tmp_path / "b.dtbo").read_bytes())


AXION = """\
module: filter
registers:
  - {name: control, addr: 0x0, access: RW, width: 32, default: 3}
  - {name: total, addr: 0x8, access: RO, width: 64}
  - {name: go, addr: 0x4, access: WO, width: 32}
"""


def test_both_files_of_axion_hdl_say_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its XML is IP-XACT of 2009's predecessor (SPIRIT 1.5), its JSON a format of its own."""
    axion = pytest.importorskip("axion_hdl", reason="needs axion-hdl: the extra [test-design] is not installed")
    (tmp_path / "filter.yaml").write_text(AXION)
    tool = axion.AxionHDL(str(tmp_path))
    tool.add_yaml_src(str(tmp_path / "filter.yaml"))
    assert tool.analyze()
    assert tool.generate_xml()
    assert tool.generate_json()
    capsys.readouterr()
    xml, by_json = (read_register_map(tmp_path / f"filter_regs.{kind}", "filter") for kind in ("xml", "json"))
    places = {name: (spec.offset, spec.access.value) for name, spec in by_json.registers.items()}
    assert places == {"control": (0, "rw"), "go": (4, "wo"), "total_0": (8, "ro"), "total_1": (12, "ro")}
    assert {name: (spec.offset, spec.access.value) for name, spec in xml.registers.items()} == places


def test_words_of_a_wide_register_of_litex_are_those_of_its_own_accessors(tmp_path: Path) -> None:
    """`csr_ordering="little"` changes the gateware, and neither of the files that tell of it."""
    pytest.importorskip("litex", reason="needs LiteX: the extra [test-design] is not installed")
    made = run(tmp_path, sys.executable, "-W", "ignore", "-c", LITEX)
    (tmp_path / "csr.json").write_text(made)
    found = read_register_map(tmp_path / "csr.json", "dev")
    assert {name: spec.offset for name, spec in found.registers.items()} == {"wide_1": 0, "wide_0": 4}
    (note,) = found.notes
    assert "whatever its order" in note


LITEX = """
import logging
from litex.build.generic_platform import Pins
from litex.build.sim import SimPlatform
from litex.gen import LiteXModule
from litex.soc.integration.export import get_csr_json
from litex.soc.integration.soc_core import SoCMini
from litex.soc.interconnect.csr import CSRStorage
from migen import ClockDomain
logging.disable(logging.CRITICAL)
class Device(LiteXModule):
    def __init__(self):
        self.wide = CSRStorage(64, name="wide")
class Clock(LiteXModule):
    def __init__(self, pin):
        self.cd_sys = ClockDomain(reset_less=True)
        self.comb += self.cd_sys.clk.eq(pin)
class Design(SoCMini):
    def __init__(self):
        platform = SimPlatform("SIM", [("clk", 0, Pins(1))])
        super().__init__(platform, int(1e6), csr_data_width=32, csr_ordering="little", ident="", ident_version=False)
        self.crg = Clock(platform.request("clk"))
        self.dev = Device()
design = Design()
design.finalize()
print(get_csr_json(design.csr_regions, design.constants, design.mem_regions))
"""


VHDL = """\
library ieee; use ieee.std_logic_1164.all;
package buses is
  type stream_t is record data : std_logic_vector(7 downto 0); valid : std_logic; end record;
end package;
library ieee; use ieee.std_logic_1164.all; use work.buses.all;
entity one is
  port (clk : in std_logic; a : in stream_t; a_data : in std_logic_vector(3 downto 0);
        none : in std_logic_vector(-1 downto 0); q : out std_logic_vector(3 downto 0));
end entity;
architecture plain of one is begin q <= a_data xor a.data(3 downto 0); end architecture;
"""


@needs("ghdl")
def test_a_record_beside_a_port_of_its_fields_name_has_a_wrapper_with_two_names(tmp_path: Path) -> None:
    """GHDL's own --synth gives both the name a_data."""
    (tmp_path / "one.vhd").write_text(VHDL)
    design = load_design(project(tmp_path, MINIMAL.replace("[one.v]", "[one.vhd]")))
    out = output_folder(design.project, None)
    generate(design, out)
    flat = out / "wrappers/one/cm_flat_one.vhd"
    ports = re.findall(r"(\w+) : (?:in|out) std_logic", flat.read_text())
    assert sorted(set(ports)) == sorted(ports)
    assert {"clk", "q"} < set(ports)
    for step in (["-a", "one.vhd"], ["-a", str(flat)], ["-e", "cm_flat_one"]):
        run(tmp_path, "ghdl", step[0], "--std=08", *step[1:])


AMARANTH = """
from amaranth.back import verilog
from amaranth.hdl import Module
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out
class One(wiring.Component):
    i: In(stream.Signature(8))
    o: Out(stream.Signature(8))
    none: In(0)
    def elaborate(self, platform):
        m = Module()
        m.d.sync += self.o.payload.eq(self.i.payload)
        m.d.sync += self.o.valid.eq(self.i.valid)
        m.d.comb += self.i.ready.eq(self.o.ready)
        return m
print(verilog.convert(One(), name="one", emit_src=False))
"""


def test_a_module_of_amaranth_is_read_whatever_the_order_of_its_ports(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A signal of width 0 is `[-1:0]` there, which Verilog takes for two bits; clk and rst stand in the middle."""
    pytest.importorskip("amaranth", reason="needs Amaranth: the extra [test-design] is not installed")
    (tmp_path / "one.v").write_text(run(tmp_path, sys.executable, "-c", AMARANTH))
    assert main(["build", "interfaces", str(tmp_path / "one.v"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [(clock["port"], clock["reset"]) for clock in found["clocks"]] == [("clk", "rst")]
    asked = {port["name"] for port in found["leftover"] if "write streams: [i, o]" in port["reason"]}
    assert asked == {f"{end}__{signal}" for end in "io" for signal in ("valid", "ready", "payload")}
    assert [(port["name"], port["width"]) for port in found["leftover"] if port["name"] == "none"] == [("none", 2)]
