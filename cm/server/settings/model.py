# SPDX-License-Identifier: Apache-2.0
"""The settings as data: what ``/etc/cm/cm.yaml`` says, the defaults where it says nothing, and the limits in bytes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from cm.frozen import dataclass, field
from cm.server.rights.model import Access, empty

FILE = Path("/etc/cm/cm.yaml")
SEARCH_PATH = ("/etc/cm/configs", "/lib/firmware/cm/*")


@dataclass(frozen=True, slots=True)
class StreamSettings:
    """Streams over ZeroMQ; `queue_mib` MiB of frames may wait for each subscriber."""

    queue_mib: float = 32


@dataclass(frozen=True, slots=True)
class DmaSettings:
    """DMA memory; `prefetch_mib` MiB are for images that are kept ready."""

    prefetch_mib: int = 64


@dataclass(frozen=True, slots=True)
class ScrubSettings:
    """A region that is compared with what was loaded, `every` so many seconds, in `budget` (0 to 1) of the port's time.

    `policy`: what is done where it is wrong: repair, or tell.
    """

    every: float = 10.0
    budget: float = 0.02
    policy: str = "repair"


@dataclass(frozen=True, slots=True)
class RecordSettings:
    """The black box (`cm record --settings`), as the command has it; without `ring` there is none."""

    folder: str = "/var/lib/cm-record"
    ring: str = ""
    streams: tuple[str, ...] = ()
    frames: str = "whole"


@dataclass(frozen=True, slots=True)
class ImportSettings:
    """Imported bundles; `keep` earlier versions of each stay for a rollback."""

    keep: int = 3


@dataclass(frozen=True, slots=True)
class PolicySettings:
    """Configurations without a signature: `signatures` off, warn or require; `signers` the folder of public keys.

    `older`: whether an import of an older version than the one in force is allowed.
    """

    signatures: str = "off"
    signers: Path = Path("/etc/cm/signers")
    older: str = "allow"


@dataclass(frozen=True, slots=True)
class LimitSettings:
    """What clients may take of the manager; see docs/limits.md. `slots_each`: one user's."""

    message_mib: int = 8
    waiting_mib: int = 32
    replies_mib: int = 16
    uploads_mib: int = 512
    leases: int = 256
    slots_each: int = 64
    provisioned_mib: int = 1024
    memory_mib: int = 256


@dataclass(frozen=True, slots=True)
class Settings:
    """What an operator may say of the service; each key is described in ``settings.schema.json``."""

    listen: tuple[str, ...] = ()
    keys: Path | None = None
    insecure: bool = False
    configs: tuple[str, ...] = SEARCH_PATH
    load: str = ""
    name: str = ""
    runtime_dir: Path | None = None
    state_dir: Path | None = None
    assume_loaded: bool = False
    log: str = "warning"
    streams: StreamSettings = StreamSettings()
    dma: DmaSettings = DmaSettings()
    scrub: Mapping[str, ScrubSettings] = field(default_factory=empty)
    record: RecordSettings = RecordSettings()
    imports: ImportSettings = ImportSettings()
    policy: PolicySettings = PolicySettings()
    limits: LimitSettings = LimitSettings()
    access: Access = Access()


_MIB = 1 << 20


@dataclass(frozen=True, slots=True)
class Limits:
    """What an operator may set (`limits` of ``/etc/cm/cm.yaml``), and the share of one user: `upload_bytes`, `…_each`.

    `message_bytes`: of one frame of a message. `waiting_bytes`: of one user's requests that wait. `replies_bytes`: of
    replies that one user has not read. `uploads_bytes`: sent in parts and not used yet. `slots_each`: of one stream.
    `memory_bytes`: for masters in the PL. `provisioned_bytes`: of configurations that clients sent.
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
            upload_bytes=said.uploads_mib * _MIB // 2,
            uploads_bytes=said.uploads_mib * _MIB,
            leases=said.leases,
            leases_each=-(-said.leases // 8),
            slots_each=said.slots_each,
            memory_bytes=said.memory_mib * _MIB,
            memory_each_bytes=said.memory_mib * _MIB * 3 // 4,
            provisioned_bytes=said.provisioned_mib * _MIB,
            provisioned_each_bytes=said.provisioned_mib * _MIB // 2,
        )


USUAL = Limits.of(LimitSettings())
