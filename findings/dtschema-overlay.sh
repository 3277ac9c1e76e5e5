#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: dt-validate checks the nodes of an overlay against their bindings, and its exit status says whether all is well.
# Seen: it looks at nothing inside __overlay__, and exits with 0 also where it has found errors in a whole tree.
. "$(dirname "$0")/setup"
pypi dtschema==2026.9
debian device-tree-compiler libfdt1
mkdir -p bindings/misc
cat >bindings/misc/example,counter.yaml <<'END'
%YAML 1.2
---
$id: http://devicetree.org/schemas/misc/example,counter.yaml#
$schema: http://devicetree.org/meta-schemas/core.yaml#
title: A counter
maintainers: [Somebody <somebody@example.org>]
properties:
  compatible:
    const: example,counter
  reg:
    maxItems: 1
  width:
    $ref: /schemas/types.yaml#/definitions/uint32
    maximum: 64
required: [compatible, reg, width]
additionalProperties: false
...
END
counter='counter@1000 { compatible = "example,counter"; reg = <0x1000 0x10>; width = <65>; surprise; };'
cells='#address-cells = <1>; #size-cells = <1>;'
echo "/dts-v1/; / { compatible = \"example,board\"; model = \"b\"; $cells pl: bus { compatible = \"simple-bus\"; $cells ranges; }; };" >base.dts
echo "/dts-v1/; /plugin/; &pl { $cells $counter };" >design.dtso
dtc -q -@ -O dtb -o base.dtb base.dts
dtc -q -@ -O dtb -o design.dtbo design.dtso
fdtoverlay -i base.dtb -o merged.dtb design.dtbo
for tree in design.dtbo merged.dtb; do
	dt-validate -s bindings $tree >$tree.said 2>&1 && echo 0 >$tree.status || echo $? >$tree.status
done
python3 - <<'END'
from pathlib import Path
from saw import saw
for tree, complaints in (("design.dtbo", 0), ("merged.dtb", 2)):
    said = [line for line in Path(f"{tree}.said").read_text().splitlines() if "counter@1000" in line and "example,counter" in line]
    about = sum(any(word in line for line in said) for word in ("surprise", "maximum"))
    saw(f"{tree}: complaints about the counter, exit status", (about, int(Path(f"{tree}.status").read_text())), (complaints, 0))
END
