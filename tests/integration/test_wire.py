# SPDX-License-Identifier: Apache-2.0
"""The protocol as others see it: plain pyzmq and the generated messages, without our client."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from manager_process import Manager

import cm
from cm.server.settings.model import USUAL
from cm.wire import cm_pb2 as pb


class Peer:
    """Sockets of a program in any language."""

    def __init__(self, manager: Manager) -> None:
        self.context = zmq.Context()
        self.others: list[zmq.Socket[bytes]] = []
        self.req = self.connect(zmq.REQ, manager, "req")
        self.pub = self.connect(zmq.XPUB, manager, "sub")  # like PUB, but it shows when it is connected
        assert self.pub.recv() == b"\x01cm_"
        self.sub = self.connect(zmq.SUB, manager, "pub")

    def connect(self, kind: int, manager: Manager, name: str) -> zmq.Socket[bytes]:
        socket = self.context.socket(kind)
        socket.linger = 0
        socket.rcvtimeo = 60_000
        socket.connect(f"ipc://{manager.runtime}/{name}")
        return socket

    def dealer(self, manager: Manager) -> zmq.Socket[bytes]:
        self.others.append(self.connect(zmq.DEALER, manager, "req"))
        return self.others[-1]

    def ask(self, *frames: bytes) -> pb.Reply:
        self.req.send_multipart(list(frames))
        topic, message, *_ = self.req.recv_multipart()
        assert frames[0].startswith(topic)
        return pb.Reply.FromString(message)

    def published(self, topic: bytes) -> list[bytes]:
        """The next message of a topic that is subscribed to."""
        while True:
            frames = self.sub.recv_multipart()
            if frames[0] == topic:
                return frames

    def status_until(self, accepts) -> pb.Status:  # type: ignore[no-untyped-def]
        self.sub.setsockopt(zmq.SUBSCRIBE, b"cm_status")
        while not accepts(status := pb.Status.FromString(self.published(b"cm_status")[1])):
            pass
        return status

    def close(self) -> None:
        for socket in self.others:
            socket.close()
        self.context.destroy(linger=0)


@pytest.fixture
def peer(board: cm.Board, manager: Manager) -> Iterator[Peer]:
    made = Peer(manager)
    yield made
    made.close()


def test_listing_2_of_the_paper_works_as_it_is_printed(peer: Peer, board: cm.Board) -> None:
    for topic in (b"cm_read_reg", b"cm_data_read"):
        peer.sub.setsockopt(zmq.SUBSCRIBE, topic)
    peer.status_until(lambda s: s.mode == "default")
    assert [len(part) for part in peer.published(b"cm_data_read")[2:]] == [480 * 640]
    peer.pub.send_multipart([b"cm_write_reg", b"{ 'focus':0x2}"])
    values = pb.RegValues.FromString(peer.published(b"cm_read_reg")[1])
    assert [(v.name, v.value) for v in values.values] == [("focus", 2)]
    peer.pub.send_multipart([b"cm_config", b"edge"])
    assert peer.status_until(lambda s: s.mode == "edge_detection" and not s.fpga_busy).pr_mode == pb.PR_MODE_IDLE


def test_a_frame_above_the_pages_limit_ends_its_connection_and_no_other(peer: Peer, manager: Manager) -> None:
    most = USUAL.message_bytes
    page = (Path(__file__).parents[2] / "docs/protocol.md").read_text(encoding="utf-8")
    assert f"A frame of a message has at most {most >> 20} MiB" in page
    dealer = peer.dealer(manager)
    dealer.send_multipart([b"cm_status", b"", bytes(most)])
    assert dealer.poll(60_000)
    dealer.recv_multipart()
    ended = dealer.get_monitor_socket(zmq.EVENT_DISCONNECTED)
    dealer.send_multipart([b"cm_status", b"", bytes(most + 1)])
    assert ended.poll(60_000)
    dealer.disable_monitor()
    ended.close(0)
    assert peer.ask(b"cm_status", b"").ok


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.one_of(
            st.binary(max_size=40),
            st.sampled_from(
                [
                    b"cm_status",
                    b"cm_read_reg",
                    b"cm_write_reg",
                    b"cm_config",
                    b"cm_write_config",
                    b"cm_data_config",
                    b"",
                ]
            ),
        ),
        min_size=1,
        max_size=5,
    )
)
def test_no_sequence_of_frames_brings_the_manager_down(peer: Peer, frames: list[bytes]) -> None:
    peer.req.send_multipart(frames)
    pb.Reply.FromString(peer.req.recv_multipart()[1])
    assert peer.ask(b"cm_status", b"").status.config_name == "camera"


def test_while_a_change_runs_the_mode_is_the_previous_one(peer: Peer, board: cm.Board) -> None:
    peer.status_until(lambda status: status.mode == "default")
    change = pb.WriteConfig(mode="edge_detection", no_wait=True).SerializeToString()
    number = peer.ask(b"cm_write_config", change).change.number
    seen = []
    peer.status_until(lambda status: seen.append(status) or status.last_change == number)
    during = [status for status in seen if status.fpga_busy]
    assert {status.mode for status in during} == {"default"}
    assert [s.progress.fraction for s in during] == sorted(s.progress.fraction for s in during)
    assert (seen[-1].mode, seen[-1].fpga_busy) == ("edge_detection", False)


def test_a_lease_without_seconds_is_shared_and_lasts_half_a_minute(peer: Peer) -> None:
    first = peer.ask(b"cm_lease", pb.Lease(scope="region:prr0").SerializeToString()).lease
    second = peer.ask(b"cm_lease", pb.Lease(scope="region:prr0").SerializeToString())
    assert (first.seconds, first.exclusive, second.ok) == (30.0, False, True)
    for lease in (first.id, second.lease.id):
        assert peer.ask(b"cm_lease", pb.Lease(id=lease, release=True).SerializeToString()).ok
