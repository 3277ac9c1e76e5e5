#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: a SystemRDL map that peakrdl-ipxact writes and reads again is the same map, or what is lost is said.
# Seen: a self-clearing bit comes back as plain storage, a bit with a write enable without it, an array whose stride
# is larger than its register cannot be written at all (IP-XACT 1685-2022 has strides), and everything is one level
# deeper. Only a memory's loss is said.
. "$(dirname "$0")/setup"
pypi systemrdl-compiler==1.33.0 peakrdl-ipxact==3.5.0
cat >map.rdl <<'END'
addrmap top {
	reg { field { sw = rw; hw = r; singlepulse; } start[0:0] = 0;
	      field { sw = rw; hw = r; swwe; } guarded[1:1] = 0;
	      field { sw = r; hw = w; rclr; } seen[2:2]; } control @ 0x0;
	external mem { mementries = 16; memwidth = 32; } table @ 0x100;
};
END
cat >sparse.rdl <<'END'
addrmap sparse { reg { field { sw = rw; } d[31:0] = 0; } channel[3] @ 0x0 += 0x10; };
END
python3 - 2>said <<'END'
from peakrdl_ipxact import IPXACTExporter, IPXACTImporter
from saw import saw
from systemrdl import RDLCompiler
from systemrdl.messages import RDLCompileError


def compiled(path):
    compiler = RDLCompiler()
    compiler.compile_file(path)
    return compiler.elaborate().top


def properties(top, path):
    found = top.find_by_path(path)
    return None if found is None else {name: bool(found.get_property(name)) for name in ("singlepulse", "swwe", "rclr")}


IPXACTExporter().export(compiled("map.rdl"), "map.xml")
compiler = RDLCompiler()
IPXACTImporter(compiler).import_file("map.xml")
back = compiler.elaborate().top
saw("control.start comes back at its path", properties(back, "control.start"), None)
saw("one level deeper it is", properties(back, "top.control.start"), {"singlepulse": False, "swwe": False, "rclr": False})
saw("the guarded bit", properties(back, "top.control.guarded"), {"singlepulse": False, "swwe": False, "rclr": False})
saw("clear on read", properties(back, "top.control.seen"), {"singlepulse": False, "swwe": False, "rclr": True})
try:
    IPXACTExporter().export(compiled("sparse.rdl"), "sparse.xml")
    refused = False
except RDLCompileError:
    refused = True
saw("an array with a stride of four words is refused", refused, True)
END
python3 - <<'END'
from pathlib import Path
from saw import saw
said = Path("said").read_text()
saw("said of the memory, of the lost properties", ("table" in said, "start" in said or "singlepulse" in said), (True, False))
END
