# SPDX-License-Identifier: Apache-2.0
"""/etc/cm/cm.yaml: settings, or SettingsError."""

from __future__ import annotations

from cm.server.settings.loader import SettingsError, parse_settings

PACKAGES = ("cm.server.settings", "cm.schema")
MAX_LENGTH = 4096


def seeds() -> list[bytes]:
    return [
        b"listen: [tcp://0.0.0.0:5560]\nkeys: /etc/cm/server.key\nlog: info\n",
        b"streams: {queue_mib: 64}\nimports: {keep: 3}\npolicy: {signatures: require, signers: /etc/cm/signers}\n",
        b"{}",
    ]


def one(data: bytes) -> None:
    try:
        parse_settings(data.decode("utf-8", "surrogateescape"))
    except SettingsError as error:
        str(error)
