# SPDX-License-Identifier: Apache-2.0
"""Sessions of zenoh on this machine alone."""

import socket

import zenoh


def free_address() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{free.getsockname()[1]}"


def session(mode: str, *, stamped: bool = False, **endpoints: str) -> zenoh.Session:
    """`endpoints`: listen and connect; `stamped`: what it publishes has a time."""
    config = zenoh.Config()
    config.insert_json5("mode", f'"{mode}"')
    config.insert_json5("scouting/multicast/enabled", "false")
    if stamped:
        config.insert_json5("timestamping/enabled", "true")
    for kind, endpoint in endpoints.items():
        config.insert_json5(f"{kind}/endpoints", f'["{endpoint}"]')
    return zenoh.open(config)
