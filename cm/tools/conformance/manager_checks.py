# SPDX-License-Identifier: Apache-2.0
"""What docs/protocol.md promises of a manager, checked on a running one, with bare sockets.

Nothing is changed unless `act`: then registers are written with what they hold, leases are taken and given back, and
each mode of the loaded configuration is entered and left again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from cm.client.find_manager import Keys
from cm.errors import Timeout
from cm.tools.conformance.peer import Broken, Peer, check, refused, until
from cm.tools.conformance.runner import Outcome
from cm.wire import cm_pb2 as pb
from cm.wire.request_table import BY_TOPIC
from cm.wire.topics import Endpoints

_NEWER = b"\xc2\xbb\x01\x03new"  # field 3000 of every message: a field that is newer than the manager


# ---- what changes nothing ---------------------------------------------------------------------


def a_req_is_answered(peer: Peer) -> None:
    """[topic][Reply]: ok, with the body and the number of the status"""
    reply = peer.ask("cm_status")
    check(reply.ok and reply.HasField("status"), "cm_status should be answered with a status")
    check(bool(reply.status.version and reply.status.started_ns), "a status tells version and start")


def frames_before_a_command_come_back(peer: Peer) -> None:
    """a DEALER with and without frames of its own, also frames that begin with cm_"""
    with peer.dealer() as dealer:
        for envelope in ([], [b"1", b""], [b"cm_client", b"\0", b""]):
            dealer.send_multipart([*envelope, b"cm_status", b""])
            answer = dealer.recv_multipart()
            check(answer[: len(envelope)] == envelope, f"{envelope} should have come back, {answer[:-1]} did")
            check(pb.Reply.FromString(answer[-1]).ok, "the status should be told")


def many_requests_have_their_own_answers(peer: Peer) -> None:
    """a hundred requests at once, each with a number"""
    with peer.dealer() as dealer:
        for count in range(100):
            number, name = b"%d" % count, f"no_{count}"
            dealer.send_multipart([number, b"", b"cm_read_config", pb.ReadConfig(config_name=name).SerializeToString()])
        for _ in range(100):
            number, _, _, message = dealer.recv_multipart()
            refused(pb.Reply.FromString(message), "unknown_config", f"no_{int(number)}")


def an_unknown_topic_is_named(peer: Peer) -> None:
    """with and without a message"""
    refused(peer.ask("cm_nothing"), "invalid_request", "cm_nothing")
    refused(peer.ask("cm_nothing", b"x"), "invalid_request", "cm_nothing")


def what_is_no_message_is_refused(peer: Peer) -> None:
    """on each topic: bytes that protobuf cannot read, payload where none belongs, and two requests in one message"""
    for topic, rows in BY_TOPIC.items():
        name = topic.decode()
        refused(peer.ask(name, b"\xff\xff\xff"), "invalid_request")
        refused(peer.ask(name, b"", b"payload", b"payload"), "invalid_request")
        both = {mark: True for row in rows for mark in row.true}
        if len(both) > 1:
            refused(peer.ask(name, rows[0].message(**both).SerializeToString()), "invalid_request")


def fields_of_newer_clients_are_ignored(peer: Peer) -> None:
    """a field that the manager does not know"""
    check(peer.ask("cm_status", _NEWER).ok, "an unknown field should be passed over")


def a_subscriber_hears_the_status_at_once(peer: Peer) -> None:
    """the one whose number replies carry, or a later one"""
    before = peer.ask("cm_status").status
    with peer.listening():
        pass
    after = peer.ask("cm_status").status
    check(before.sequence <= after.sequence, "the numbers of statuses should grow")


def the_list_tells_configurations_with_their_modes(peer: Peer) -> None:
    """names, entries, default modes"""
    config = peer.ask("cm_read_config", pb.ReadConfig(list=True).SerializeToString()).config
    check([e.name for e in config.entries] == list(config.names), "names and entries should be the same, in one order")
    for entry in config.entries:
        check(entry.default_mode in entry.modes, f"{entry.name}: its default mode should be one of its modes")


def registers_are_read_with_their_fields(peer: Peer) -> None:
    """values, and the bits of each field in them"""
    reply = peer.ask("cm_read_reg")
    if not reply.ok:
        refused(reply, "nothing_loaded")
        return
    config = peer.ask("cm_read_config").config
    fields = {(r.name, f.name): f for r in config.registers for f in r.fields}
    for value in reply.registers.values:
        for name, part in value.fields.items():
            field = fields[value.name, name]
            check(value.value >> field.lsb & (1 << field.width) - 1 == part, f"{value.name}.{name} is not in its bits")
    refused(peer.ask("cm_read_reg", pb.ReadReg(names=["no such"]).SerializeToString()), "unknown_register", "no such")


# ---- what acts --------------------------------------------------------------------------------


def leases_are_shared_unless_they_are_exclusive(peer: Peer) -> None:
    """defaults, refusal with held_by, the way back"""
    first = peer.ask("cm_lease", pb.Lease(scope="board").SerializeToString()).lease
    try:
        check((first.seconds, first.exclusive) == (30.0, False), "a lease that says nothing is shared, for 30 s")
        refused(peer.ask("cm_lease", pb.Lease(scope="board", exclusive=True).SerializeToString()), "held_by")
    finally:
        given = peer.ask("cm_lease", pb.Lease(id=first.id, release=True).SerializeToString())
    check(given.ok, "a lease can be given back")
    refused(peer.ask("cm_lease", pb.Lease(id=first.id, release=True).SerializeToString()), "unknown_lease")


def a_write_is_published_with_its_generation(peer: Peer) -> None:
    """what a register holds is written to it again"""
    config = peer.ask("cm_read_config").config
    values = {v.name: v.value for v in peer.ask("cm_read_reg").registers.values}
    plain = [r.name for r in config.registers if r.access == "rw" and r.name in values]
    check(bool(plain), "no register of this mode can be read and written")
    write = pb.WriteReg(writes=[pb.RegWrite(name=plain[0], value=values[plain[0]])]).SerializeToString()
    with peer.listening("cm_read_reg") as sub:
        first, second = (peer.ask("cm_write_reg", write).registers.generation for _ in range(2))
        check(second > first > 0, "each write makes a generation of its own")
        until(sub, "cm_read_reg", lambda m: pb.RegValues.FromString(m).generation == second)


def a_change_is_told_from_its_begin_to_its_end(peer: Peer) -> None:
    """another mode and back: while it runs, the status has the mode of before"""
    status = peer.ask("cm_status").status
    config = peer.ask("cm_read_config").config
    others = [m.name for m in config.modes if m.name != status.mode]
    for mode in (others[0], status.mode) if others else ():
        before = peer.ask("cm_status").status.mode
        with peer.listening() as sub:
            request = pb.WriteConfig(mode=mode, no_wait=True).SerializeToString()
            number = peer.ask("cm_write_config", request).change.number
            while True:
                told = pb.Status.FromString(until(sub, "cm_status", lambda _: True))
                if told.last_change == number:
                    break
                check(
                    not told.fpga_busy or told.mode in (before, ""), f"{told.mode} is told before the change has ended"
                )
        check(told.mode == mode, f"{mode} was asked for; {told.mode} came of it: {told.last_error.message}")


LOOKS: tuple[Callable[[Peer], None], ...] = (
    a_req_is_answered,
    frames_before_a_command_come_back,
    many_requests_have_their_own_answers,
    an_unknown_topic_is_named,
    what_is_no_message_is_refused,
    fields_of_newer_clients_are_ignored,
    a_subscriber_hears_the_status_at_once,
    the_list_tells_configurations_with_their_modes,
    registers_are_read_with_their_fields,
)
ACTS: tuple[Callable[[Peer], None], ...] = (
    leases_are_shared_unless_they_are_exclusive,
    a_write_is_published_with_its_generation,
    a_change_is_told_from_its_begin_to_its_end,
)


def run(endpoints: Endpoints, keys: Keys | None, act: bool) -> Iterator[Outcome]:
    """Each promise, and whether it is kept."""
    peer = Peer(endpoints, keys)
    try:
        for promise in (*LOOKS, *(ACTS if act else ())):
            name = promise.__name__.replace("_", "-")
            says = (promise.__doc__ or "").strip()
            try:
                promise(peer)
            except (Broken, Timeout) as error:
                yield Outcome(name, says, "failed", str(error))
            else:
                yield Outcome(name, says, "passed")
    finally:
        peer.close()
