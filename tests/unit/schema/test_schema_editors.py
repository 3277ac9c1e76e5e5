# SPDX-License-Identifier: Apache-2.0
"""The JSON Schema file by itself, as editors use it: it takes the normal form and refuses mistakes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import fastjsonschema
import pytest
import yaml
from hypothesis import given, settings
from strategies import configs

import cm.schema
from cm.schema.model import Config

CAMERA = Path(cm.schema.__file__).parents[1] / "data" / "camera" / "camera.yaml"


@pytest.fixture(scope="module")
def validate() -> Callable[[Any], Any]:
    compiled: Callable[[Any], Any] = fastjsonschema.compile(cm.schema.json_schema())
    return compiled


def test_the_camera_is_valid(validate: Callable[[Any], Any]) -> None:
    validate(yaml.safe_load(CAMERA.read_text()))


@settings(max_examples=10, deadline=None)
@given(config=configs())
def test_what_is_written_is_valid(validate: Callable[[Any], Any], config: Config) -> None:
    validate(yaml.safe_load(cm.schema.dump(config)))


@pytest.mark.parametrize(
    "text",
    [
        "config: {modes: {}}",
        "config: {name: c, mode: {}}",
        "config: {name: c, modes: {m: {modules: [a.b]}}}",
        "config: {name: c, streams: {s: {shape: [1]}}}",
        "config: {name: c, mmio: [{base_address: 0, registers: {r: {offset: 0, width: 24}}}]}",
        "config: {name: c, overlays: [{file: x}]}",
        "config: {name: c, memories: {m: {base_address: 0}}}",
        "config: {name: c, mmio: [{base_address: 0, memories: {m: {size: 4, access: w1c}}}]}",
        "other: {}",
    ],
)
def test_a_mistake_is_refused(validate: Callable[[Any], Any], text: str) -> None:
    with pytest.raises(fastjsonschema.JsonSchemaValueException):
        validate(yaml.safe_load(text))
