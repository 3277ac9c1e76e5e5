# SPDX-License-Identifier: Apache-2.0
"""Where the manager is: runtime folder, endpoints, keys."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

from cm.errors import InvalidRequest, NotFound
from cm.wire.topics import Endpoints, ipc_endpoints, tcp_endpoints

SYSTEM_DIR = Path("/run/cm")


@dataclass(frozen=True, slots=True)
class Keys:
    """CURVE keys of a client, and the manager's public key (Z85, 40 characters each)."""

    server_public: bytes
    public: bytes
    secret: bytes


def default_runtime_dir() -> Path:
    """`$CM_RUNTIME_DIR`, else /run/cm if a manager serves there (or root asks), else `$XDG_RUNTIME_DIR`/cm.

    Raises InvalidRequest on other systems than Linux, where no manager runs.
    """
    chosen = os.environ.get("CM_RUNTIME_DIR")
    if chosen:
        return Path(chosen)
    if sys.platform != "linux":
        raise InvalidRequest(
            "a configuration manager runs on a Linux board, not here: say which one, "
            "connect('tcp://kria.local'), or --connect tcp://kria.local"
        )
    if (SYSTEM_DIR / "req").exists() or os.geteuid() == 0:
        return SYSTEM_DIR
    user = os.environ.get("XDG_RUNTIME_DIR")
    return Path(user) / "cm" if user else Path(f"/tmp/cm-{os.getuid()}")


def resolve(endpoint: str | None, runtime_dir: str | os.PathLike[str] | None) -> Endpoints:
    """The three ZeroMQ endpoints of a manager.

    `endpoint` is ``tcp://host[:port]`` or a runtime folder (``ipc://…`` too). Raises InvalidRequest,
    and NotFound where the folder holds no manager's sockets.
    """
    if endpoint is not None and runtime_dir is not None:
        raise InvalidRequest("give an endpoint or a runtime folder, not both")
    if endpoint is not None and endpoint.startswith("tcp://"):
        return tcp_endpoints(endpoint)
    folder = Path(endpoint.removeprefix("ipc://") if endpoint else runtime_dir or default_runtime_dir())
    if not (folder / "req").exists():
        raise NotFound(f"no configuration manager serves {folder}: start one ('cm serve'), or name its --runtime-dir")
    return ipc_endpoints(folder)


def load_keys(path: str | os.PathLike[str]) -> Keys:
    """Keys from a file that ``cm keygen`` wrote: lines ``name: value``. Raises InvalidRequest."""
    lines = Path(path).read_text(encoding="ascii").splitlines()
    pairs = dict(line.split(":", 1) for line in lines if ":" in line and not line.startswith("#"))
    try:
        found = [pairs[n].strip().encode() for n in ("server-public", "public", "secret")]
    except KeyError as missing:
        raise InvalidRequest(f"{path}: no {missing} key; a client's file has server-public, public, secret") from None
    return Keys(*found)
