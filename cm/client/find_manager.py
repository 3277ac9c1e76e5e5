# SPDX-License-Identifier: Apache-2.0
"""Where the manager is, and how a client reaches it: runtime folder, endpoints, keys."""

from __future__ import annotations

import os
import re
import sys
from contextlib import suppress
from pathlib import Path

from cm.client.errors import NotAdmitted
from cm.errors import InvalidRequest, NotFound
from cm.frozen import dataclass
from cm.wire import plane_packets as packets
from cm.wire.topics import Endpoints, ipc_endpoints, split_tcp, tcp_endpoints

SYSTEM_DIR = Path("/run/cm")
_Z85 = re.compile(rb"[0-9a-zA-Z.\-:+=^!/*?&<>()\[\]{}@%$#]{40}")

_NAME = 64  # characters of a guest's name


@dataclass(frozen=True, slots=True)
class Keys:
    """CURVE keys of a client, and the manager's public key (Z85, 40 characters each). Raises InvalidRequest."""

    server_public: bytes
    public: bytes
    secret: bytes

    def __post_init__(self) -> None:
        for name in ("server_public", "public", "secret"):
            if not _Z85.fullmatch(getattr(self, name)):
                raise InvalidRequest(
                    f"the key {name} is not one: keys are 40 characters of Z85, as 'cm keygen' makes them"
                )


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
            "connect('tcp://kria.local'), --connect tcp://kria.local, or CM_CONNECT=tcp://kria.local"
        )
    if os.geteuid() == 0 or _serves(SYSTEM_DIR):
        return SYSTEM_DIR
    own = _users_dir()
    if _serves(SYSTEM_DIR) is None and not _serves(own):  # one that we may not use: the error says so
        return SYSTEM_DIR
    return own


def _users_dir() -> Path:
    user = os.environ.get("XDG_RUNTIME_DIR")
    if user or sys.platform == "win32":  # which has no such ids
        return Path(user or ".") / "cm"
    return Path(f"/tmp/cm-{os.getuid()}")


def _is_of_another_user(folder: Path) -> bool:
    """Whether the default folder was made by another user."""
    if sys.platform == "win32":
        return False
    return folder == _users_dir() and folder.stat().st_uid not in (0, os.geteuid())


def _serves(folder: Path) -> bool | None:
    """Whether a folder contains a manager's sockets; None if we may not look."""
    try:
        return (folder / "req").exists()
    except PermissionError:
        return None


def resolve(endpoint: str | os.PathLike[str] | None, runtime_dir: str | os.PathLike[str] | None) -> Endpoints:
    """The three ZeroMQ endpoints of a manager.

    `endpoint` is ``tcp://host[:port]`` or a runtime folder (``ipc://…`` too). Raises InvalidRequest, and NotFound if
    the folder holds no manager's sockets.
    """
    if endpoint is not None and runtime_dir is not None:
        raise InvalidRequest("give an endpoint or a runtime folder, not both")
    endpoint = os.fspath(endpoint) if endpoint is not None else None
    if endpoint == "":
        raise InvalidRequest("endpoint '': it is tcp://host[:port], or a runtime folder; none at all: this machine's")
    if endpoint is not None and endpoint.startswith("tcp://"):
        if not _can_be_host(split_tcp(endpoint)[0]):
            raise InvalidRequest(
                f"endpoint {endpoint!r} is not tcp://host[:port]: a host is a name of ASCII letters, digits, - and ., "
                "or an address, for IPv6 as in tcp://[2001:db8::1]"
            )
        return tcp_endpoints(endpoint)
    if endpoint is not None and "://" in endpoint.removeprefix("ipc://"):
        raise InvalidRequest(f"endpoint {endpoint!r}: it is tcp://host[:port], or the runtime folder of a manager here")
    folder = Path(endpoint.removeprefix("ipc://") if endpoint else runtime_dir or default_runtime_dir())
    serves = _serves(folder)
    if serves is False:
        other = f"; a manager on another machine is tcp://{endpoint}" if endpoint and os.sep not in endpoint else ""
        raise NotFound(
            f"no configuration manager serves {folder}: start one ('cm serve', without a board 'cm serve --sim'), "
            f"or name its --runtime-dir{other}"
        )
    if serves is None or not os.access(folder / "req", os.W_OK):
        raise NotAdmitted(_not_for_us(folder))
    if not endpoint and not runtime_dir and _is_of_another_user(folder):
        raise NotAdmitted(f"{folder} belongs to another user: its manager is not ours")
    return ipc_endpoints(folder)


def _can_be_host(host: str) -> bool:
    """What zmq_connect() does not refuse as an invalid argument (libzmq's socket_base.cpp); brackets come in pairs."""
    plain = host.translate(dict.fromkeys(b".-:%;[]_*"))
    return plain.isascii() and plain.isalnum() and host[0] not in ".-%;]_*" and host.count("[") == host.count("]")


def _not_for_us(folder: Path) -> str:
    """Who may use the sockets of a folder, and how to get that permission."""
    try:
        name = _group(folder)
    except (OSError, KeyError, ImportError):
        name = "its group"
    if name == "root":
        return f"this user may not use the sockets in {folder}: they are for root, until cm.yaml names an access.group"
    return (
        f"this user may not use the sockets in {folder}: they are for members of {name} "
        f"(sudo usermod -aG {name} $USER, then log in again)"
    )


def _group(folder: Path) -> str:
    if sys.platform == "win32":
        return "its group"
    import grp

    return grp.getgrgid(folder.stat().st_gid).gr_name


def unreached(endpoint: str) -> str:
    """Why no answer can come from ``tcp://host[:port]``: it does not resolve, or refuses connections; or "".

    Asks the resolver, and the host, which may take seconds: for when no answer came.
    """
    import socket  # here: a connection that works needs none

    if not endpoint.startswith("tcp://"):
        return ""
    host, port = split_tcp(endpoint)
    host = host.rpartition(";")[2].strip("[]")  # behind libzmq's own address, if there is one
    try:
        socket.getaddrinfo(host, None)
    except (OSError, UnicodeError) as error:
        return f"the name {host!r} does not resolve ({getattr(error, 'strerror', None) or error})"
    with suppress(OSError):
        try:
            socket.create_connection((host, port), 1.0).close()
        except ConnectionRefusedError:
            return f"nothing listens on port {port} there, as a manager with 'listen' does"
    return ""


def deserted(endpoint: str) -> str:
    """Why no answer comes from a socket of this machine that a killed manager has left; or ""."""
    if sys.platform == "win32" or not endpoint.startswith("ipc://"):
        return ""
    import socket

    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe, suppress(OSError):
        probe.setblocking(False)
        try:
            probe.connect(endpoint.removeprefix("ipc://"))
        except ConnectionRefusedError:
            return "nobody serves that socket any more, the manager was killed; start it again"
    return ""


def load_keys(path: str | os.PathLike[str]) -> Keys:
    """Keys from a file that ``cm keygen`` wrote: lines ``name: value``. Raises InvalidRequest."""
    try:
        lines = Path(path).read_text(encoding="ascii").splitlines()
    except UnicodeDecodeError:
        raise InvalidRequest(f"{path} is not a key file: 'cm keygen' writes lines 'name: value' in ASCII") from None
    pairs = dict(line.split(":", 1) for line in lines if ":" in line and not line.startswith("#"))
    try:
        found = [pairs[n].strip().encode() for n in ("server-public", "public", "secret")]
    except KeyError as missing:
        raise InvalidRequest(f"{path}: no {missing} key; a client's file has server-public, public, secret") from None
    try:
        return Keys(*found)
    except InvalidRequest as error:
        raise InvalidRequest(f"{path}: {error}") from None


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
