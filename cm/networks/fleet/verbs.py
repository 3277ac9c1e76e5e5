# SPDX-License-Identifier: Apache-2.0
"""Commands under ``do/``: the message that carries each to the manager, and the role that it needs."""

from __future__ import annotations

from dataclasses import dataclass

from cm.wire import topics


@dataclass(frozen=True, slots=True)
class Verb:
    """A command: its message, and its topic at the manager; without a topic the bridge carries it out itself."""

    message: str
    role: str
    topic: bytes = b""


VERBS = {
    "mode": Verb("WriteConfig", "operate", topics.WRITE_CONFIG),
    "reg": Verb("WriteReg", "operate", topics.WRITE_REG),
    "stream": Verb("DataConfig", "operate", topics.DATA_CONFIG),
    "data": Verb("WriteData", "operate", topics.WRITE_DATA),
    "lease": Verb("Lease", "operate", topics.LEASE),
    "upload": Verb("Upload", "operate", topics.UPLOAD),
    "provision": Verb("WriteConfig", "provision", topics.WRITE_CONFIG),
    "prepare": Verb("FleetStep", "operate"),
    "apply": Verb("FleetStep", "operate"),
    "reconcile": Verb("FleetStep", "operate"),
    "bundle": Verb("FetchBundle", "provision"),
}
