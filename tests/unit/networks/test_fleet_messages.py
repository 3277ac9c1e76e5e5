# SPDX-License-Identifier: Apache-2.0
"""Messages of fleets: round trips, what a bridge appends to a status, and JSON."""

from __future__ import annotations

import json

import pytest

from cm.errors import InvalidRequest
from cm.wire import cm_pb2 as pb
from cm.wire import fleet as wire
from cm.wire import fleet_records as records
from cm.wire.encode import encode_status
from cm.wire.json_text import from_json, to_json
from cm.wire.messages.fleet import BundleState, ClockSync, Decision, FetchBundle, FleetRecord, FleetStep, Policy
from cm.wire.messages.status import ErrorInfo, PrMode, RegionStatus, Status

RECORD = FleetRecord(
    "c1", "applied", "camera", "edge", "camera", "default", ("b1", "b2"), Decision.KEEP,
    ErrorInfo("busy", "no"), 0.5, 7, 0.25,
    "anna", ("b1", "b2"), Policy.QUORUM, 12.5, 7, Decision.REVERT, 5,
)  # fmt: skip


def test_steps_records_and_bundles_come_back_as_they_were_sent() -> None:
    step = FleetStep("c1", "camera", "edge", ("b1",), ("b1", "b2"), Policy.BEST_EFFORT, 7.5, True, 9)
    assert records.decode_step(records.encode_step(step)) == step
    assert records.decode_record(records.encode_record(RECORD)) == RECORD
    fetch = FetchBundle("0" * 64, 5, ("1" * 64, "2" * 64), 4, "a.tar.gz")
    assert wire.decode_fetch(wire.encode_fetch(fetch)) == fetch
    for answer in (RECORD, BundleState("0" * 64, 5, 4, "camera", "anna"), ErrorInfo("busy", "no")):
        assert wire.decode_answer(wire.encode_answer(answer)) == answer


def test_what_a_bridge_adds_stands_behind_the_managers_own_bytes() -> None:
    status = Status("camera", "edge", pr_mode=PrMode.PARTIAL, regions=(RegionStatus("prr0", "edge", "ready"),))
    clock = ClockSync("chrony", True, 1500, "192.0.2.1", 10**18)
    own = bytes(encode_status(status)[1])
    found = wire.board_status(own + wire.extras(("north", "camera"), clock, RECORD))
    assert (found.status, found.labels, found.clock, found.fleet) == (status, ("north", "camera"), clock, RECORD)


@pytest.mark.parametrize("name", ["", "a/b", "x" * 65, "a\n", "é"])
def test_an_id_that_is_not_a_file_name_is_refused(name: str) -> None:
    with pytest.raises(InvalidRequest, match="1 to 64 printable characters"):
        records.decode_step(records.encode_step(FleetStep(name)))


def test_a_step_with_one_seat_is_that_of_an_older_client() -> None:
    assert records.decode_step(pb.FleetStep(id="c1", seat="b1").SerializeToString()).seats == ("b1",)


def test_a_ballot_after_which_none_can_come_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="they go up one by one"):
        records.decode_step(records.encode_step(FleetStep("c1", ballot=2**63)))


@pytest.mark.parametrize("seconds", [-1.0, float("nan"), float("inf"), 1e9])
def test_a_time_after_which_no_board_would_ever_ask_is_refused(seconds: float) -> None:
    with pytest.raises(InvalidRequest, match="seconds until boards ask for the decision"):
        records.decode_step(records.encode_step(FleetStep("c1", seconds=seconds)))


def test_a_policy_is_known_by_what_users_type_and_by_what_messages_hold() -> None:
    spellings = ("best-effort", "best_effort", "best effort", Policy.BEST_EFFORT)
    assert {Policy.of(said) for said in spellings} == {Policy.BEST_EFFORT}
    sent = pb.FleetStep(id="c1", policy="best-effort").SerializeToString()
    assert records.decode_step(sent).policy.spelt == "best-effort"
    with pytest.raises(InvalidRequest, match=r"policy 'most': one of all, quorum, best-effort is wanted"):
        records.policy("most")


def test_a_record_with_an_invalid_decision_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="keep or revert is wanted"):
        records.decode_record(pb.FleetRecord(id="c1", decision="maybe").SerializeToString())


def test_a_bundle_whose_parts_do_not_add_up_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="has 2 parts"):
        wire.decode_fetch(wire.encode_fetch(FetchBundle("0" * 64, 5, ("1" * 64,), 4)))
    with pytest.raises(InvalidRequest, match="64 hexadecimal digits"):
        wire.decode_fetch(wire.encode_fetch(FetchBundle("0" * 64, 4, ("../" * 21 + "x",), 4)))


def test_messages_are_json_with_the_names_of_the_protocol() -> None:
    data = from_json("WriteReg", '{"writes": [{"name": "focus", "value": "18446744073709551615"}]}')
    assert json.loads(to_json("WriteReg", data))["writes"][0]["value"] == str(2**64 - 1)
    with pytest.raises(InvalidRequest, match=r"WriteReg as JSON: .*writings"):
        from_json("WriteReg", '{"writings": []}')
    with pytest.raises(InvalidRequest, match="not a valid Status message"):
        to_json("Status", b"\xff\xff\xff")
