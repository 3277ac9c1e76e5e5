# SPDX-License-Identifier: Apache-2.0
"""Topics, endpoints and ports, as docs/protocol.md fixes them."""

from __future__ import annotations

from pathlib import Path

from cm.errors import InvalidRequest
from cm.frozen import dataclass

STATUS = b"cm_status"
READ_CONFIG = b"cm_read_config"
WRITE_CONFIG = b"cm_write_config"
READ_REG = b"cm_read_reg"
WRITE_REG = b"cm_write_reg"
DATA_CONFIG = b"cm_data_config"
READ_DATA = b"cm_read_data"
WRITE_DATA = b"cm_write_data"
IRQ = b"cm_irq"
LEASE = b"cm_lease"
UPLOAD = b"cm_upload"
REGION = b"cm_region"
AUDIT = b"cm_audit"  # who changes what; published to those who name it

TEXT_CONFIG = b"cm_config"  # the paper's spelling of cm_write_config
DATA_READ = b"cm_data_read"  # the paper's spelling of cm_read_data
STREAM_PREFIX = b"cm_stream/"  # one stream's frames: cm_stream/<name>

DEFAULT_PORT = 5560
MAX_IPC_PATH = 107  # sun_path of unix(7), less its NUL


@dataclass(frozen=True, slots=True)
class Endpoints:
    """The three ZeroMQ endpoints of one configuration manager, as ZeroMQ addresses."""

    pub: str
    sub: str
    req: str


def ipc_endpoints(runtime_dir: Path) -> Endpoints:
    """Endpoints of a manager on this machine. Raises InvalidRequest if the path is too long for a Unix socket."""
    folder = runtime_dir.absolute()
    try:
        length = len(str(folder / "pub").encode())
    except UnicodeEncodeError:
        raise InvalidRequest(f"runtime folder {str(folder)!a} has a name that is no UTF-8: choose another") from None
    if length > MAX_IPC_PATH:
        raise InvalidRequest(
            f"runtime folder {folder} is too long for a socket ({MAX_IPC_PATH} bytes with the socket's name): "
            "choose a shorter one with --runtime-dir"
        )
    return Endpoints(*(f"ipc://{folder}/{name}" for name in ("pub", "sub", "req")))


def tcp_endpoints(address: str) -> Endpoints:
    """Endpoints behind ``tcp://host[:port]``: the port of pub, the next of sub, the next of req."""
    host, port = split_tcp(address)
    return Endpoints(*(f"tcp://{host}:{port + i if port else '*'}" for i in range(3)))


def split_tcp(address: str) -> tuple[str, int]:
    """``tcp://host[:port]`` → host, port (5560 if none is given). IPv6 hosts stand in brackets."""
    rest = address.removeprefix("tcp://")
    if rest == address or not rest:
        raise InvalidRequest(f"endpoint {address!r} is not tcp://host[:port]")
    host, colon, port = rest.rpartition(":")
    if not colon or rest.endswith("]"):
        return rest, DEFAULT_PORT
    if not port.isdigit() or int(port) > 65533:
        raise InvalidRequest(f"endpoint {address!r}: the port must be a number up to 65533 (three in a row are used)")
    return host, int(port)
