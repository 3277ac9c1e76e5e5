# SPDX-License-Identifier: Apache-2.0
"""How much one client may use, and all together, in bytes; docs/limits.md says what happens beyond each."""

from __future__ import annotations

from dataclasses import dataclass

from cm.server.settings.model import LimitSettings

_MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class Limits:
    """What an operator may set (`limits` of ``/etc/cm/cm.yaml``, where the defaults are); `…_each` is of one client.

    `message_bytes`: of one frame of a message. `waiting_bytes`: of one client's requests that wait. `replies_bytes`:
    of replies that it has not read. `upload_bytes`, `uploads_bytes`: sent in parts and not used yet, of one client and
    of all. `slots_each`: of one stream. `memory_bytes`, `memory_each_bytes`: for masters in the PL, of all and of one
    client. `provisioned_bytes`, `provisioned_each_bytes`: of configurations that clients sent.
    """

    message_bytes: int
    waiting_bytes: int
    replies_bytes: int
    upload_bytes: int
    uploads_bytes: int
    leases: int
    leases_each: int
    slots_each: int
    memory_bytes: int
    memory_each_bytes: int
    provisioned_bytes: int
    provisioned_each_bytes: int

    @staticmethod
    def of(said: LimitSettings) -> Limits:
        """The settings' limits, in bytes."""
        return Limits(
            message_bytes=said.message_mib * _MIB,
            waiting_bytes=said.waiting_mib * _MIB,
            replies_bytes=said.replies_mib * _MIB,
            upload_bytes=said.upload_mib * _MIB,
            uploads_bytes=said.uploads_mib * _MIB,
            leases=said.leases,
            leases_each=said.leases_each,
            slots_each=said.slots_each,
            memory_bytes=said.memory_mib * _MIB,
            memory_each_bytes=said.memory_each_mib * _MIB,
            provisioned_bytes=said.provisioned_mib * _MIB,
            provisioned_each_bytes=said.provisioned_each_mib * _MIB,
        )


USUAL = Limits.of(LimitSettings())
