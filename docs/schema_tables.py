# SPDX-License-Identifier: Apache-2.0
"""Write the tables of keys in ``schema-keys.md`` from the JSON Schema: ``python docs/schema_tables.py``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent
PAGE = DOCS / "schema-keys.md"
SCHEMA = DOCS.parent / "cm" / "schema" / "data" / "runtime.schema.json"
BEGIN = "<!-- made by docs/schema_tables.py: begin -->\n"
END = "<!-- made by docs/schema_tables.py: end -->\n"
SECTIONS = {
    "config": "config",
    "static_identity": "static",
    "region": "regions.NAME",
    "decoupler": "regions.NAME.decoupler",
    "gpio_line": "regions.NAME.decoupler.gpio",
    "isolation_step": "regions.NAME.decoupler.sequence[]",
    "identity": "regions.NAME.identity",
    "frames": "regions.NAME.footprint[]",
    "module": "modules.NAME",
    "mode": "modes.NAME",
    "window": "mmio[]",
    "register": "registers.NAME",
    "field": "registers.NAME.fields.NAME",
    "memory": "memories.NAME",
    "stream": "streams.NAME",
    "camera_info": "streams.NAME.camera_info",
    "interrupt": "interrupts.NAME",
    "clock": "clocks.NAME",
    "overlay": "overlays[]",
}
WORDS = {"string": "text", "integer": "integer", "number": "number", "boolean": "true or false"}


def tables(schema: dict[str, Any]) -> str:
    """The tables of all keys, as Markdown."""
    definitions = schema["definitions"]
    return "\n".join(_section(title, definitions[name], definitions) for name, title in SECTIONS.items())


def page(text: str, schema: dict[str, Any]) -> str:
    """`text` with its tables made anew."""
    head, rest = text.split(BEGIN)
    return head + BEGIN + "\n" + tables(schema) + END + rest.split(END)[1]


def _section(title: str, shape: dict[str, Any], definitions: dict[str, Any]) -> str:
    shape = shape.get("anyOf", [shape])[-1]
    required = shape.get("required", ())
    rows = [_row(key, value, key in required, definitions) for key, value in shape["properties"].items()]
    head = ["| key | value | default | meaning |", "|---|---|---|---|"]
    return "\n".join([f"## `{title}`", "", shape["description"], "", *head, *rows, ""])


def _row(key: str, value: dict[str, Any], required: bool, definitions: dict[str, Any]) -> str:
    value = _follow(value, definitions)
    default = "**required**" if required else f"`{json.dumps(value['default'])}`" if "default" in value else ""
    default = default.replace('"', "")
    return f"| `{key}` | {_kind(value, definitions)} | {default} | {value.get('description', '')} |"


def _follow(value: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    while "$ref" in value:
        value = definitions[value["$ref"].rsplit("/", 1)[1]]
    return value


def _kind(value: dict[str, Any], definitions: dict[str, Any]) -> str:
    """What a value may be, in a few words."""
    value = _follow(value, definitions)
    if "anyOf" in value:
        return " or ".join(dict.fromkeys(_kind(choice, definitions) for choice in value["anyOf"]))
    if "enum" in value:
        return ", ".join(f"`{choice}`" for choice in value["enum"])
    if value["type"] == "array":
        return f"list of {_kind(value['items'], definitions)}"
    if value["type"] == "object":
        inner = value["additionalProperties"]
        return "map" if "properties" in value else f"map from names to {_kind(inner, definitions)}"
    if value.get("pattern") == definitions["name"]["pattern"]:
        return "name"
    kinds = [value["type"]] if isinstance(value["type"], str) else value["type"]
    return " or ".join(WORDS[kind] for kind in kinds)


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(), json.loads(SCHEMA.read_text())))
