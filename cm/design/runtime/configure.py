# SPDX-License-Identifier: Apache-2.0
"""`cm build configure`: asks what a runtime schema leaves open, or takes the answers from a file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from cm.design.errors import BuildError
from cm.design.plan.system import System
from cm.design.runtime.answers import Answers, at_key, parse_answers
from cm.design.runtime.schema import runtime_config
from cm.frozen import dataclass
from cm.schema.model import ITEM_BYTES
from cm.schema.problems import did_you_mean

Ask = Callable[[str], str]


@dataclass(frozen=True, slots=True)
class Question:
    """`key`: as in the file of answers; `default`: used if the answer is empty."""

    key: str
    text: str
    default: Any
    choices: tuple[str, ...] = ()
    low: int | None = None
    high: int | None = None


def questions(system: System) -> Iterator[Question]:
    """Yield everything that is to be decided, in a fixed order."""
    config = runtime_config(system, Answers())
    yield Question("default_mode", "mode after start", config.default_mode, tuple(config.modes))
    text = "devices of the static part by an overlay of the CM (no: they are in the board's device tree)"
    yield Question("static_overlay", text, True)
    for name, stream in config.streams.items():
        shape = list(stream.shape) if stream.shape else []
        yield Question(f"streams.{name}.shape", f"stream {name}: shape of a frame (empty: flat bytes)", shape)
        yield Question(f"streams.{name}.dtype", f"stream {name}: numpy dtype", stream.dtype)
        yield Question(f"streams.{name}.slots", f"stream {name}: buffers", stream.slots, (), 2, 64)
    for module in config.modules.values():
        for register in module.registers.values():
            if register.access.value in ("rw", "wo") and register.default is not None:
                high = register.maximum if register.maximum is not None else (1 << register.width) - 1
                key = f"registers.{module.name}.{register.name}"
                text = f"module {module.name}: {register.name} when its mode is entered"
                yield Question(key, text, register.default, (), register.minimum or 0, high)


def answer_all(
    asked: list[Question],
    given: Mapping[str, Any],
    ask: Ask | None,
    source: Path,
    earlier: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Answer every question: as `given`, else from `ask` (None: as `earlier`, else the default).

    `earlier`: the previous answers, offered in place of the defaults. Raises BuildError for a given key
    that is not asked for, or an invalid value.
    """
    known = {question.key for question in asked}
    for key in given:
        if key not in known:
            hint = did_you_mean(key, sorted(known))
            raise BuildError(f"{at_key(source, key)}: there is no such question ({hint})")
    answers: dict[str, Any] = {}
    for question in asked:
        if question.key in given:
            wrong = problem(question, given[question.key])
            if wrong:
                raise BuildError(f"{at_key(source, question.key)}: {wrong}")
            answers[question.key] = given[question.key]
        else:
            offered = (earlier or {}).get(question.key, question.default)
            if problem(question, offered):
                offered = question.default
            answers[question.key] = offered if ask is None else _ask(question, offered, ask)
    return answers


def _ask(question: Question, offered: Any, ask: Ask) -> Any:
    """Ask until the answer is valid."""
    note = ""
    while True:
        choices = f" ({', '.join(question.choices)})" if question.choices else ""
        text = ask(f"{note}{question.text}{choices} [{_shown(offered)}]: ").strip()
        if not text:
            return offered
        value = _value(question, text)
        wrong = problem(question, value)
        if not wrong:
            return value
        note = f"{wrong}\n"


def _value(question: Question, text: str) -> Any:
    if isinstance(question.default, bool):
        return {"yes": True, "y": True, "true": True, "no": False, "n": False, "false": False}.get(text.lower(), text)
    if isinstance(question.default, list):
        parts = text.strip("[]").replace("x", ",").replace(" ", ",").split(",")
        return [_integer(part) for part in parts if part]
    return _integer(text) if isinstance(question.default, int) else text


def _integer(text: str) -> Any:
    try:
        return int(text, 0)
    except ValueError:
        return text


def problem(question: Question, value: Any) -> str:
    """Say what is wrong with an answer; empty if nothing is."""
    if question.choices and value not in question.choices:
        return f"{value!r} is none of {', '.join(question.choices)}"
    if isinstance(question.default, bool):
        return "" if isinstance(value, bool) else f"{value!r} is neither yes nor no"
    if isinstance(question.default, list):
        good = isinstance(value, list) and all(isinstance(size, int) and size > 0 for size in value)
        return "" if good else f"{value!r} is not a shape (like 480,640,3)"
    if isinstance(question.default, int):
        if not isinstance(value, int) or isinstance(value, bool):
            return f"{value!r} is not an integer"
        low, high = question.low or 0, question.high
        return "" if low <= value and (high is None or value <= high) else f"{value} is not within {low} to {high}"
    if question.key.endswith(".dtype"):
        return _dtype_problem(value)
    return ""


def _dtype_problem(value: Any) -> str:
    return "" if value in list(ITEM_BYTES) else f"{value!r} is not a numpy dtype of frames ({', '.join(ITEM_BYTES)})"


def _shown(default: Any) -> str:
    if isinstance(default, bool):
        return "yes" if default else "no"
    return ",".join(map(str, default)) if isinstance(default, list) else str(default)


def as_text(answers: Mapping[str, Any], asked: list[Question]) -> str:
    """Write the file of answers: those that differ from the build schema, and the others as comments."""
    lines = ["# SPDX-License-Identifier: Apache-2.0", "# Answers to cm build configure; cm build generate reads them."]
    for question in asked:
        value = answers[question.key]
        text = yaml.safe_dump(value, default_flow_style=True).removesuffix("\n...\n").strip()
        mark = "# " if value == question.default else ""
        lines.append(f"{mark}{question.key}: {text}")
    return "\n".join(lines) + "\n"


def to_answers(answers: Mapping[str, Any], asked: list[Question], source: Path) -> Answers:
    """Return the answers that differ from the build schema, in the form that `generate` takes."""
    default = {question.key: question.default for question in asked}
    return parse_answers({key: value for key, value in answers.items() if value != default[key]}, source)
