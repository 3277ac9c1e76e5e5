# SPDX-License-Identifier: Apache-2.0
"""Prometheus' text exposition format, version 0.0.4 (its documentation: "Exposition formats")."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from cm.metrics.counts import Distribution, Times

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
Labels = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Family:
    """A metric: its samples are (suffix of the name, labels, value)."""

    name: str
    kind: str  # counter, gauge, histogram or summary
    help: str
    samples: tuple[tuple[str, Labels, float], ...]


def single(name: str, kind: str, help_text: str, value: float) -> Family:
    """A metric of one value."""
    return Family(name, kind, help_text, (("", {}, value),))


def by_label(name: str, kind: str, help_text: str, label: str, values: Mapping[str, float]) -> Family:
    """A metric of one label."""
    return Family(name, kind, help_text, tuple(("", {label: key}, values[key]) for key in sorted(values)))


def many(name: str, kind: str, help_text: str, samples: Iterable[tuple[Labels, float]]) -> Family:
    """A metric of several labels."""
    return Family(name, kind, help_text, tuple(("", labels, value) for labels, value in samples))


def histogram(name: str, help_text: str, found: Distribution) -> Family:
    """A distribution."""
    bounds = (*(f"{bound:g}" for bound in found.bounds), "+Inf")
    buckets = [("_bucket", {"le": le}, count) for le, count in zip(bounds, found.at_most, strict=True)]
    return Family(name, "histogram", help_text, (*buckets, ("_sum", {}, found.sum), ("_count", {}, found.at_most[-1])))


def times(name: str, help_text: str, label: str, found: Mapping[str, Times]) -> Family:
    """Seconds by label, as a summary without quantiles."""
    samples = [
        (suffix, {label: key}, value)
        for key in sorted(found)
        for suffix, value in (("_sum", found[key].seconds), ("_count", found[key].number))
    ]
    return Family(name, "summary", help_text, tuple(samples))


def render(families: Sequence[Family]) -> bytes:
    """The text of all families that have samples."""
    return "".join(line for family in families if family.samples for line in _lines(family)).encode()


def _lines(family: Family) -> Iterator[str]:
    yield f"# HELP {family.name} {_escaped(family.help)}\n"
    yield f"# TYPE {family.name} {family.kind}\n"
    for suffix, labels, value in family.samples:
        inside = ",".join(f'{name}="{_quoted(text)}"' for name, text in labels.items())
        yield f"{family.name}{suffix}{f'{{{inside}}}' if inside else ''} {_number(value)}\n"


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace("\n", r"\n")


def _quoted(text: str) -> str:
    return _escaped(text).replace('"', r"\"")


def _number(value: float) -> str:
    if isinstance(value, int):
        return str(int(value))  # of a bool too
    if math.isinf(value):
        return "+Inf" if value > 0 else "-Inf"
    return "NaN" if math.isnan(value) else repr(value)
