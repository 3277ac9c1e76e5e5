# SPDX-License-Identifier: Apache-2.0
"""The settings of the service: ``/etc/cm/cm.yaml`` (docs/service.md).

The reader of YAML is imported when it is first used, so that a start without a settings file does not pay for it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from cm.server.settings.model import Settings

if TYPE_CHECKING:
    from cm.server.settings.config_search import Found, find_configs
    from cm.server.settings.loader import SettingsError, SettingsMissing, load_settings, parse_settings, settings_schema

__all__ = [
    "Found",
    "Settings",
    "SettingsError",
    "SettingsMissing",
    "find_configs",
    "load_settings",
    "parse_settings",
    "settings_schema",
]


if not TYPE_CHECKING:  # to a type checker it would allow any name

    def __getattr__(name: str) -> Any:
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        home = "config_search" if name in ("Found", "find_configs") else "loader"
        return getattr(import_module(f"{__name__}.{home}"), name)
