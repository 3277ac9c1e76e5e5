# SPDX-License-Identifier: Apache-2.0
"""Plain values → YAML text that our reader and every YAML 1.1 and 1.2 reader take the same way."""

from __future__ import annotations

from typing import Any

import yaml

from cm.schema.scalars import is_octal_trap, resolve


class Hex(int):
    """An integer that is written in hexadecimal."""


class _Dumper(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002 - PyYAML's signature
        return True


def _hex(dumper: _Dumper, value: Hex) -> yaml.ScalarNode:
    return dumper.represent_scalar("tag:yaml.org,2002:int", hex(value))


def _text(dumper: _Dumper, value: str) -> yaml.ScalarNode:
    """Quote what a reader might take for something else: a YAML 1.2 number, or a line break that folds."""
    printable = value.replace("\n", "").isprintable()
    plain = printable and isinstance(resolve(value), str) and not is_octal_trap(value)
    return dumper.represent_scalar("tag:yaml.org,2002:str", value, style=None if plain else '"')


def _list(dumper: _Dumper, value: list[Any]) -> yaml.SequenceNode:
    """Lists of names and numbers on one line."""
    flat = not any(isinstance(item, (list, dict)) for item in value)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", value, flow_style=flat)


_Dumper.add_representer(Hex, _hex)
_Dumper.add_representer(str, _text)
_Dumper.add_representer(list, _list)


def to_yaml(data: dict[str, Any]) -> str:
    """`data` as YAML; the order of keys is kept."""
    text: str = yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=110)
    return text
