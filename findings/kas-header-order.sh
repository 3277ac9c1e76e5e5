#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: kas writes the parts of local_conf_header in the order of the files, so that the including file has the last word.
# Seen: `kas dump` shows that order, and local.conf has them sorted by name: here the included file's part comes last and
# wins. A list of targets is replaced, not joined, while layers and variables are.
. "$(dirname "$0")/setup"
pypi kas==5.5
git init -q .
mkdir -p meta-one meta-two
cat >base.yml <<'END'
header: {version: 20}
machine: qemuarm64
distro: nodistro
target: [one]
local_conf_header:
  zynq: |
    SIZE = "base"
repos: {here: {path: ., layers: {meta-one: }}}
END
cat >board.yml <<'END'
header: {version: 20, includes: [base.yml]}
target: [two]
local_conf_header:
  board: |
    SIZE = "board"
repos: {here: {layers: {meta-two: }}}
END
printf 'mkdir -p "$1" && cd "$1"\n' >oe-init-build-env
chmod +x oe-init-build-env
kas dump board.yml >dumped 2>/dev/null
kas checkout board.yml >said 2>&1 || { cat said; exit 1; }
python3 - <<'END'
import re
from saw import saw

values = re.compile(r'SIZE = "(\w+)"')
saw("order of kas dump", values.findall(open("dumped").read()), ["base", "board"])
saw("order of local.conf", values.findall(open("build/conf/local.conf").read()), ["board", "base"])
saw("targets", re.findall(r"- (one|two)\b", open("dumped").read()), ["two"])
saw("layers", re.findall(r"meta-\w+", open("build/conf/bblayers.conf").read()), ["meta-one", "meta-two"])
END
