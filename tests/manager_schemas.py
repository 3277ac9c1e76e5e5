# SPDX-License-Identifier: Apache-2.0
"""Configurations for tests of changes: two regions, whole images, regions loaded by overlay; one board for all."""

from __future__ import annotations

from pathlib import Path

from cm.schema import load
from cm.schema.model import Config

REGIONS = """
  regions:
    prr0:
      decoupler: {base_address: 0x1000, offset: 0x0, bit: 0}
      identity: {base_address: 0x2000, offset: 0x1000}
      timeout: 60
    prr1:
      decoupler: {base_address: 0x1000, offset: 0x0, bit: 1}
      identity: {base_address: 0x6000, offset: 0x1000}
      timeout: 60
"""

DUO = f"""
config:
  name: duo
  type: partial
  device: xc7z020
{REGIONS}
  modules:
    a0: {{region: prr0, identity: 0xa0}}
    b0: {{region: prr0, identity: 0xb0}}
    a1: {{region: prr1, identity: 0xa1}}
    b1: {{region: prr1, identity: 0xb1}}
  mmio:
    - base_address: 0x1000
      registers:
        led: {{offset: 0x18}}
        scratch: {{offset: 0x14}}
    - base_address: 0x2000
      region: prr0
      registers:
        gain: {{offset: 0x1010, default: 1}}
    - base_address: 0x6000
      region: prr1
      registers:
        depth: {{offset: 0x1010, default: 2}}
  streams:
    through0: {{direction: s2mm, region: prr0, shape: [4, 4]}}
    through1: {{direction: s2mm, region: prr1, shape: [4, 4]}}
  overlays: [duo_base]
  modes:
    default: {{modules: [a0, a1], registers: {{lamp: {{base_address: 0x1000, offset: 0x1c}}}}}}
    other: {{modules: [b0]}}
    both: {{modules: [b0, b1], overlays: [duo_extra]}}
    lit: {{modules: [b0, a1], registers: {{lamp: {{base_address: 0x1000, offset: 0x1c, default: 5}}}}}}
"""

WHOLE = f"""
config:
  name: whole
  type: full
  device: xc7z020
{REGIONS}
  modules:
    w0: {{region: prr0, identity: 0xc0}}
    w1: {{region: prr1, identity: 0xc1}}
  mmio:
    - base_address: 0x1000
      registers:
        led: {{offset: 0x18, default: 7}}
  overlays: [whole_base]
  modes:
    default: {{modules: [w0]}}
    full: {{modules: [w0, w1], overlays: [whole_extra]}}
"""

PORTED = """
config:
  name: ported
  type: full
  device: xc7z020
  loader: icap
  mmio:
    - base_address: 0x1000
      registers:
        led: {offset: 0x18, default: 9}
  modes:
    only: {}
"""

KERNEL = f"""
config:
  name: kernel
  type: partial
  device: xc7z020
{REGIONS.replace("timeout: 60", "timeout: 60" + chr(10) + "      loader: overlay")}
  modules:
    k0: {{region: prr0, identity: 0xd0}}
    l0: {{region: prr0, identity: 0xe0}}
    k1: {{region: prr1, identity: 0xd1}}
    l1: {{region: prr1, identity: 0xe1}}
  modes:
    default: {{modules: [k0, k1], overlays: [kernel_base]}}
    other: {{modules: [l0], overlays: [kernel_base]}}
    both: {{modules: [l0, l1], overlays: [kernel_base, kernel_extra]}}
"""

MANAGED = KERNEL.replace("name: kernel", "name: managed").replace("loader: overlay", "loader: fpga_manager")

TEXTS = {"duo": DUO, "whole": WHOLE, "ported": PORTED, "kernel": KERNEL, "managed": MANAGED}


def written(folder: Path, names: tuple[str, ...] = tuple(TEXTS)) -> dict[str, Config]:
    """The configurations, read from files in `folder`."""
    found = {}
    for name in names:
        path = folder / f"{name}.yaml"
        path.write_text(TEXTS[name], encoding="utf-8")
        found[name] = load(path)
    return found
