# SPDX-License-Identifier: Apache-2.0
"""How much one client may use, and all together; docs/limits.md lists every bound and what happens beyond it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class Limits:
    """What an operator may set (`limits` of ``/etc/cm/cm.yaml``); `…_each` is of one client.

    A client is a process of this machine, or an address beyond it. `message_bytes`: of one ZeroMQ message.
    `waiting_bytes`: of one client's requests that wait. `replies_bytes`: of replies that it has not read.
    `upload_bytes`, `uploads_bytes`: sent in parts and not used yet, of one client and of all. `slots_each`: of one
    stream. `memory_bytes`, `memory_each_bytes`: for masters in the PL, of all and of one client. `shares`: of the
    loop's time if several wait, by the name of a user or a key; 1 for those not named.
    """

    connections: int = 1024
    connections_each: int = 256
    message_bytes: int = 8 * MIB
    waiting_bytes: int = 32 * MIB
    replies_bytes: int = 16 * MIB
    upload_bytes: int = 256 * MIB
    uploads_bytes: int = 512 * MIB
    leases: int = 256
    leases_each: int = 32
    slots_each: int = 64
    memory_bytes: int = 256 * MIB
    memory_each_bytes: int = 192 * MIB
    shares: Mapping[str, float] = field(default_factory=dict)
