# SPDX-License-Identifier: Apache-2.0
"""Where a client's board is, and how it is reached, for the blocking and the asyncio client."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from cm.client.address import Keys, load_keys, resolve
from cm.errors import InvalidRequest
from cm.frozen import dataclass
from cm.wire import plane_packets as packets
from cm.wire.topics import Endpoints

_NAME = 64  # characters of a guest's name


@dataclass(frozen=True, slots=True)
class Place:
    """Endpoints, keys, and the folder of the data socket, which only the manager's own machine has.

    `guest`: in whose name a bridge makes requests; guests have no data socket, as it would only know the bridge.
    """

    endpoints: Endpoints
    keys: Keys | None
    data: Path | None
    guest: str = ""

    @property
    def local(self) -> bool:
        """Whether the manager runs on this machine."""
        return self.endpoints.req.startswith("ipc://")

    def data_folder(self, what: str) -> Path:
        """The folder of the data socket. Raises InvalidRequest if there is none."""
        if self.guest:
            raise InvalidRequest(f"{what} needs the manager's data socket, which knows no guests of a bridge")
        if self.data is None:
            raise InvalidRequest(f"{what} needs the manager's data socket, which only its own machine has")
        return self.data

    def check_subscription(self) -> None:
        """Raise InvalidRequest if a bridge would listen with its own rights in the name of a guest."""
        if self.guest:
            raise InvalidRequest(
                f"what is published is handed to the bridge, not to {self.guest!r}: subscribe without a guest, "
                "and hold back what is not for it"
            )


def find(
    endpoint: str | os.PathLike[str] | None,
    runtime_dir: str | os.PathLike[str] | None,
    keys: str | os.PathLike[str] | Keys | None,
    guest: str = "",
) -> Place:
    """The arguments are those of `connect`, by default from `$CM_CONNECT` and `$CM_KEYS`.

    Raises InvalidRequest, NotFound.
    """
    if len(guest) > _NAME or not guest.isprintable():
        raise InvalidRequest(f"guest={guest!r}: a name of at most {_NAME} characters, all printable")
    if endpoint is None and runtime_dir is None:
        endpoint = os.environ.get("CM_CONNECT") or None
    endpoints = resolve(endpoint, runtime_dir)
    folder = Path(endpoints.req.removeprefix("ipc://")).parent
    local = endpoints.req.startswith("ipc://")
    # On other systems than Linux a folder can only hold forwarded sockets, and frames come over ZeroMQ.
    data = folder if local and not guest and sys.platform == "linux" and (folder / packets.SOCKET).exists() else None
    if keys is None and not local:
        keys = os.environ.get("CM_KEYS") or None
    return Place(endpoints, keys if keys is None or isinstance(keys, Keys) else load_keys(keys), data, guest)
