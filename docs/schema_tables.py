# SPDX-License-Identifier: Apache-2.0
"""Write the lists of keys in ``schema-keys.md`` and ``build-keys.md`` from their JSON Schemas (`make docs`)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent
BEGIN = "<!-- made by docs/schema_tables.py: begin -->\n"
END = "<!-- made by docs/schema_tables.py: end -->\n"
# Of each page the JSON Schema, and where in it is what a list's title says
SECTIONS = {
    "schema-keys.md": (
        "cm/schema/data/runtime.schema.json",
        {
            "config": "definitions/config",
            "static": "definitions/static_identity",
            "regions.NAME": "definitions/region",
            "regions.NAME.decoupler": "definitions/decoupler",
            "regions.NAME.decoupler.gpio": "definitions/gpio_line",
            "regions.NAME.decoupler.sequence[]": "definitions/isolation_step",
            "regions.NAME.identity": "definitions/identity",
            "regions.NAME.footprint[]": "definitions/frames",
            "modules.NAME": "definitions/module",
            "modes.NAME": "definitions/mode",
            "mmio[]": "definitions/window",
            "registers.NAME": "definitions/register",
            "registers.NAME.fields.NAME": "definitions/field",
            "memories.NAME": "definitions/memory",
            "streams.NAME": "definitions/stream",
            "streams.NAME.camera_info": "definitions/camera_info",
            "interrupts.NAME": "definitions/interrupt",
            "blocks.NAME": "definitions/block",
            "clocks.NAME": "definitions/clock",
            "overlays[]": "definitions/overlay",
        },
    ),
    "build-keys.md": (
        "cm/design/data/build.schema.json",
        {
            "build.yaml": "",
            "project": "properties/project",
            "clocks.NAME": "properties/clocks/additionalProperties",
            "static": "properties/static",
            "bitstream": "properties/bitstream",
            "regions.NAME": "definitions/region",
            "regions.NAME.resources": "definitions/resources",
            "regions.NAME.interfaces.NAME": "definitions/connection",
            "modules.NAME": "definitions/module",
            "modules.NAME.clocks.NAME": "definitions/module/properties/clocks/additionalProperties",
            "modules.NAME.resets.NAME": "definitions/module/properties/resets/additionalProperties",
            "modules.NAME.registers.NAME": "definitions/registers/additionalProperties",
            "modules.NAME.registers.NAME.fields.NAME": (
                "definitions/registers/additionalProperties/properties/fields/additionalProperties"
            ),
            "modules.NAME.memories.NAME": "definitions/module/properties/memories/additionalProperties",
            "modes.NAME": "properties/modes/additionalProperties",
            "modes.NAME.streams.NAME": (
                "properties/modes/additionalProperties/properties/streams/additionalProperties"
            ),
            "switch": "properties/switch",
            "switch.inputs.NAME": "definitions/end",
        },
    ),
}
WORDS = {"string": "text", "integer": "integer", "number": "number", "boolean": "boolean", "null": "null"}


def page(name: str) -> str:
    """A page with its lists as the JSON Schema is now."""
    path, sections = SECTIONS[name]
    schema = json.loads((DOCS.parent / path).read_text())
    made: list[str] = []
    above: dict[str, str] = {}
    for title, where in sections.items():
        made.append(_section(title, _at(schema, where), schema["definitions"], above))
    head, rest = (DOCS / name).read_text().split(BEGIN)
    return head + BEGIN + "\n" + "\n".join(made) + END + rest.split(END)[1]


def _at(schema: dict[str, Any], where: str) -> dict[str, Any]:
    found = schema
    for key in filter(None, where.split("/")):
        found = found[key]
    return found


def _section(title: str, shape: dict[str, Any], definitions: dict[str, Any], above: dict[str, str]) -> str:
    """The list of a shape. Several keys of a list ``above``, word for word, are named with that list's title."""
    choice = shape.get("anyOf", [shape])[-1]
    shape, said = choice, choice.get("description") or shape.get("description", "")
    required = shape.get("required", ())
    keys = {key: value for key, value in shape["properties"].items() if key != "doc"}
    rows = {key: _row(key, value, key in required, definitions) for key, value in keys.items()}
    known: dict[str, list[str]] = {}
    for key, row in rows.items():
        if row in above:
            known.setdefault(above[row], []).append(f"`{key}`")
    known = {first: names for first, names in known.items() if len(names) > 1}
    listed = [row for row in rows.values() if above.get(row) not in known]
    listed += [f"- {', '.join(names)}: as in `{first}`." for first, names in known.items()]
    is_new = said and not any(row.endswith(f". {said}") for row in above)
    for row in rows.values():
        above.setdefault(row, title)
    return "\n".join([f"## `{title}`", "", *([said, ""] if is_new else []), *listed, ""])


def _row(key: str, value: dict[str, Any], required: bool, definitions: dict[str, Any]) -> str:
    value = _follow(value, definitions)
    beside = ", **required**" if required else ""
    if "default" in value and not required:
        beside = f", default `{json.dumps(value['default'])}`".replace('"', "")
    return f"- `{key}`: {_kind(value, definitions)}{beside}. {value.get('description', '')}".rstrip()


def _follow(value: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    """What a reference names, with what stands beside the reference."""
    while "$ref" in value:
        beside = {key: each for key, each in value.items() if key != "$ref"}
        value = _at(definitions, value["$ref"].removeprefix("#/definitions/")) | beside
    return value


def _kind(value: dict[str, Any], definitions: dict[str, Any]) -> str:
    """What a value may be, in a few words."""
    value = _follow(value, definitions)
    if "anyOf" in value:
        any_of = " or ".join(dict.fromkeys(_kind(choice, definitions) for choice in value["anyOf"]))
        return any_of.replace("text or list of texts", "texts")  # as the head of the page says
    if "complex128" in value.get("enum", ()):
        return "dtype"  # the head of each page lists them
    if "w1crs" in value.get("enum", ()):
        return "one of [these](schema.md#a-first-example)"
    if "enum" in value:
        return ", ".join(f"`{choice}`" for choice in value["enum"])
    if value["type"] == "array":
        return f"list of {_several(value['items'], definitions)}"
    if value["type"] == "object":
        inner = value["additionalProperties"]
        if "properties" in value:
            return "map"
        return f"{'maps' if 'additionalProperties' in inner else _several(inner, definitions)} by name"
    if value.get("pattern") == definitions["name"]["pattern"]:
        return "name"
    kinds = [value["type"]] if isinstance(value["type"], str) else value["type"]
    return " or ".join(WORDS[kind] for kind in kinds)


def _several(value: dict[str, Any], definitions: dict[str, Any]) -> str:
    """What several values may be."""
    kinds = _kind(value, definitions).split(" or ")
    return " or ".join(f"{kind}s" if kind.isalpha() and kind != "texts" else kind for kind in kinds)


if __name__ == "__main__":
    for each in SECTIONS:
        (DOCS / each).write_text(page(each))
