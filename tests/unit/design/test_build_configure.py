# SPDX-License-Identifier: Apache-2.0
"""What only the user can decide: it is asked, kept, and used by every later generation."""

from __future__ import annotations

from pathlib import Path

import pytest
from build_support import copy_examples, generated

from cm import schema
from cm.cli.main import main
from cm.design.errors import BuildError
from cm.design.generate.generation import Design
from cm.design.runtime.configure import Question, answer_all, questions


@pytest.fixture
def camera(tmp_path: Path) -> tuple[Design, Path]:
    return generated(copy_examples(tmp_path), "camera")


def test_the_runtime_schema_marks_what_is_to_be_decided(camera: tuple[Design, Path]) -> None:
    text = (camera[1] / "config/camera.yaml").read_text()
    assert "  # decide: the mode after start, one of default, edge_detection, colorise\n  default_mode: default" in text
    assert "    # decide: shape, dtype and slots of a frame\n    camera:" in text


def test_questions_are_asked_with_defaults_until_the_answer_is_valid(camera: tuple[Design, Path]) -> None:
    asked = list(questions(camera[0].system))
    replies = {"mode after start": ["night", "colorise"], "stream camera: shape": ["240x320x4"]}
    shown: list[str] = []

    def reply(prompt: str) -> str:
        shown.append(prompt)
        found = next((key for key in replies if key in prompt), None)
        return replies[found].pop(0) if found else ""

    answers = answer_all(asked, {}, reply, Path("terminal"))
    assert answers["default_mode"] == "colorise"
    assert answers["streams.camera.shape"] == [240, 320, 4]
    assert answers["registers.edge.zoom"] == 1
    assert any("'night' is none of default, edge_detection, colorise" in prompt for prompt in shown)


def test_answers_from_a_file_reach_the_schema_and_stay(camera: tuple[Design, Path], tmp_path: Path) -> None:
    design, out = camera
    given = tmp_path / "answers.yaml"
    given.write_text("default_mode: edge_detection\nstreams.camera.shape: [240, 320, 4]\nregisters.edge.focus: 7\n")
    assert main(["build", "configure", str(design.project.source), "--answers", str(given)]) == 0
    for _ in range(2):
        config = schema.load(out / "config/camera.yaml")
        assert config.default_mode == "edge_detection"
        assert config.streams["camera"].shape == (240, 320, 4)
        assert config.modules["edge"].registers["focus"].default == 7
        assert main(["build", "generate", str(design.project.source)]) == 0


def test_the_static_overlay_can_be_left_to_the_boards_tree(camera: tuple[Design, Path], tmp_path: Path) -> None:
    given = tmp_path / "answers.yaml"
    given.write_text("static_overlay: false\n")
    assert main(["build", "configure", str(camera[0].project.source), "--answers", str(given)]) == 0
    assert schema.load(camera[1] / "config/camera.yaml").overlays == ()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("defalt_mode: edge\n", "did you mean default_mode?"),
        ("default_mode: night\n", "is none of"),
        ("streams.camera.dtype: unit8\n", "not a numpy dtype"),
        ("streams.camera.slots: 1\n", "not within 2 to 64"),
        ("streams.camera.shape: 5\n", "not a shape"),
        ("registers.edge.focus: 99\n", "not within 0 to 15"),
        ("- a\n", "expected a map"),
    ],
)
def test_a_wrong_answer_is_reported(
    text: str, words: str, camera: tuple[Design, Path], tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    given = tmp_path / "answers.yaml"
    given.write_text(text)
    assert main(["build", "configure", str(camera[0].project.source), "--answers", str(given)]) == 1
    assert words in capsys.readouterr().err


def test_a_value_for_an_unknown_question_is_reported() -> None:
    with pytest.raises(BuildError, match="no such question"):
        answer_all([Question("a", "a", 1)], {"b": 2}, None, Path("file"))
