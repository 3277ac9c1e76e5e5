# SPDX-License-Identifier: Apache-2.0
"""The form of the paper's Listing 1 loads character for character."""

from __future__ import annotations

from pathlib import Path

import cm.schema
from cm.schema.model import ConfigType, Overlay

LISTING = Path(__file__).parents[1] / "data" / "listing1.yaml"


def test_listing_1_loads_verbatim() -> None:
    config = cm.schema.load(LISTING)
    assert (config.name, config.type) == ("camera", ConfigType.PARTIAL)
    assert list(config.modules) == ["default", "edge", "colorise"]
    assert list(config.modes) == ["edge_detection", "default"]
    assert list(config.regions) == ["prr0"]
    mode = config.modes["edge_detection"]
    assert mode.modules == ("edge",)
    assert mode.overlays == (Overlay("camera"),)
    focus = mode.registers["focus"]
    assert (focus.address, focus.default, focus.region) == (0x3010, 1, "prr0")
    assert config.modes["default"].overlays == (Overlay("camera"),)
    assert config.first_mode() == "default"
