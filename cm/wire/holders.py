# SPDX-License-Identifier: Apache-2.0
"""Leases, windows and clients in the status ↔ protobuf messages."""

from __future__ import annotations

from cm.wire import cm_pb2 as pb
from cm.wire.messages import status as st


def lease_state_to_pb(x: st.LeaseStatus) -> pb.LeaseState:
    return pb.LeaseState(
        number=x.number,
        scope=x.scope,
        exclusive=x.exclusive,
        holder=x.holder,
        client=x.client,
        pid=x.pid,
        seconds=x.seconds,
    )


def lease_state_from_pb(m: pb.LeaseState) -> st.LeaseStatus:
    return st.LeaseStatus(m.number, m.scope, m.exclusive, m.holder, m.client, m.pid, m.seconds)


def window_to_pb(x: st.WindowStatus) -> pb.WindowState:
    return pb.WindowState(**x._asdict())


def window_from_pb(m: pb.WindowState) -> st.WindowStatus:
    what = m.number, m.region, m.module, m.address, m.length, m.writes, m.exclusive
    return st.WindowStatus(*what, m.client, m.pid)


def client_to_pb(x: st.ClientStatus) -> pb.ClientState:
    return pb.ClientState(
        name=x.name,
        connections=x.connections,
        leases=x.leases,
        slots=x.slots,
        upload_bytes=x.upload_bytes,
        waiting_bytes=x.waiting_bytes,
        loop_seconds=x.loop_seconds,
        requests=x.requests,
        refused=x.refused,
        account=x.account,
        waiting=x.waiting,
        memory_bytes=x.memory_bytes,
        unread_bytes=x.unread_bytes,
    )


def client_from_pb(m: pb.ClientState) -> st.ClientStatus:
    return st.ClientStatus(
        m.name,
        m.connections,
        m.leases,
        m.slots,
        m.upload_bytes,
        m.waiting_bytes,
        m.loop_seconds,
        m.requests,
        m.refused,
        m.account,
        m.waiting,
        m.memory_bytes,
        m.unread_bytes,
    )
