# SPDX-License-Identifier: Apache-2.0
"""The runtime schema: YAML files that say what a configuration is made of (``docs/schema.md``).

    import cm.schema
    config = cm.schema.load("camera.yaml")   # cm.schema.model.Config, frozen

`cm.schema.model` is the data alone and imports neither YAML nor the JSON Schema; the functions
here are imported when they are first used, so that code that needs only the model does not pay for them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cm.schema.loader import check, json_schema, load, load_folder, loads, schema_files
    from cm.schema.problems import Problem, SchemaError
    from cm.schema.writer import dump

__all__ = ["Problem", "SchemaError", "check", "dump", "json_schema", "load", "load_folder", "loads", "schema_files"]

_HOMES = {"dump": "writer", "Problem": "problems", "SchemaError": "problems"}


if not TYPE_CHECKING:  # for a type checker it would allow all

    def __getattr__(name: str) -> Any:
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_HOMES.get(name, 'loader')}"), name)
