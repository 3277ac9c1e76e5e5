# SPDX-License-Identifier: Apache-2.0
"""Messages of fleets: round trips, and what a bridge appends to a status."""

from __future__ import annotations

import pytest

from cm.errors import InvalidRequest
from cm.wire import fleet as wire
from cm.wire.encode import encode_status, encoded
from cm.wire.messages.fleet import BundleState, FetchBundle, FleetState, FleetStep, Policy
from cm.wire.messages.status import ErrorInfo, PrMode, RegionStatus, Status

STATE = FleetState(
    "changed", 3, 2, "camera", "default", "bob", "c1", "camera", "edge", ErrorInfo("busy", "no"), "away", 0.5, 7, 0.25
)


def test_steps_states_and_bundles_come_back_as_they_were_sent() -> None:
    step = FleetStep("c1", "camera", "edge", 9)
    assert wire.decode_step(encoded(step)) == step
    fetch = FetchBundle("0" * 64, 5, "a.tar.gz")
    assert wire.decode_fetch(encoded(fetch)) == fetch
    for answer in (STATE, BundleState("0" * 64, 5, 4, "camera", "anna"), ErrorInfo("busy", "no")):
        assert wire.decode_answer(wire.encode_answer(answer)) == answer


def test_what_a_bridge_adds_stands_behind_the_managers_own_bytes() -> None:
    status = Status("camera", "edge", pr_mode=PrMode.PARTIAL, regions=(RegionStatus("prr0", "edge", "ready"),))
    own = bytes(encode_status(status)[1])
    found = wire.board_status(own + wire.extras(("north", "camera"), STATE))
    assert (found.status, found.labels, found.fleet) == (status, ("north", "camera"), STATE)


@pytest.mark.parametrize("name", ["", "a/b", "x" * 65, "a\n", "é"])
def test_an_id_that_is_not_a_file_name_is_refused(name: str) -> None:
    with pytest.raises(InvalidRequest, match="1 to 64 printable characters"):
        wire.decode_step(encoded(FleetStep(name)))


def test_a_policy_is_known_by_what_users_type_and_by_what_messages_hold() -> None:
    spellings = ("best-effort", "best_effort", "best effort", Policy.BEST_EFFORT)
    assert {Policy.of(said) for said in spellings} == {Policy.BEST_EFFORT}
    with pytest.raises(InvalidRequest, match=r"policy 'most': one of all, quorum, best-effort is wanted"):
        Policy.of("most")


@pytest.mark.parametrize(("sha256", "length"), [("0" * 64, 0), ("0" * 63, 5), ("../" * 21 + "x", 5)])
def test_a_bundle_without_a_length_or_a_hash_that_is_a_file_name_is_refused(sha256: str, length: int) -> None:
    with pytest.raises(InvalidRequest, match="64 hexadecimal digits"):
        wire.decode_fetch(encoded(FetchBundle(sha256, length)))
