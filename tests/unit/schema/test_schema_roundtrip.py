# SPDX-License-Identifier: Apache-2.0
"""A configuration written in normal form loads unchanged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from hypothesis import Phase, given, settings
from strategies import configs

import cm.schema
from cm.schema.model import Config

CAMERA = Path(cm.schema.__file__).parents[1] / "data" / "camera" / "camera.yaml"
LISTING = Path(__file__).parents[2] / "data" / "listing1.yaml"


def without_source(config: Config) -> Config:
    return replace(config, source=None, sha256_source="")


@settings(max_examples=25, deadline=None, phases=set(Phase) - {Phase.explain})  # explaining traces every line
@given(configs())
def test_a_written_configuration_loads_as_what_it_was_in_its_order(config: Config) -> None:
    again = without_source(cm.schema.loads(cm.schema.dump(config)))
    assert again == config
    assert list(again.modes) == list(config.modes)
    for mode in config.modes:
        assert list(again.visible_registers(mode)) == list(config.visible_registers(mode))
        assert list(again.visible_memories(mode)) == list(config.visible_memories(mode))


@pytest.mark.parametrize("path", [CAMERA, LISTING], ids=lambda path: path.stem)
def test_the_examples_survive_writing(path: Path) -> None:
    config = cm.schema.load(path)
    assert without_source(cm.schema.loads(cm.schema.dump(config))) == without_source(config)


@pytest.mark.parametrize("doc", ["0o17", "1e3", "010", "no", "~", "7:4", "a: b # c", "x\ny\n", "\x85\u2028\x00", " x "])
def test_text_that_looks_like_another_type_stays_text(doc: str) -> None:
    config = cm.schema.loads("config: {name: c, modes: {default: {}}}")
    assert cm.schema.loads(cm.schema.dump(replace(config, doc=doc))).doc == doc


def test_other_readers_of_yaml_read_the_normal_form_alike() -> None:
    text = cm.schema.dump(cm.schema.load(CAMERA))
    data = yaml.safe_load(text)["config"]
    assert data["modules"]["edge"]["identity"] == 0xCA3E0002
    assert data["modes"]["colorise"]["streams"]["camera"] == {"shape": [480, 640, 3]}
