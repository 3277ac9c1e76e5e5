# SPDX-License-Identifier: Apache-2.0
"""Archives to many boards: over each way once, resumed, checked, and put in force as signatures let them."""

from __future__ import annotations

import hashlib
import json
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fleet_support import FleetBoard, Router, fleet_boards
from manager_process import until

import cm.fleet
from cm.build.collect.layout import archive
from cm.cli.main import main
from cm.fleet.bundles import Cache, PartMissing, Parts, described, fetched, offered, part_key
from cm.fleet.network import Network, session
from cm.messages.fleet import BundleState
from cm.messages.status import ErrorInfo
from cm.wire import cm_pb2 as pb

EDGE = random.Random(1).randbytes(150_000)
SCHEMA = f"""
config:
  name: vision
  modules:
    edge: {{bitstream: edge.bin, sha256: {hashlib.sha256(EDGE).hexdigest()}}}
  modes:
    contours: {{modules: [edge]}}
""".encode()


@pytest.fixture(scope="module")
def router() -> Iterator[Router]:
    found = Router()
    yield found
    found.kill()


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sent") / "vision.tar.gz"
    path.write_bytes(archive("vision", {"vision.yaml": SCHEMA, "edge.bin": EDGE}))
    return path


def joined(router: Router) -> Any:
    return session(Network(connect=(router.endpoint,)))


def test_what_has_come_is_not_fetched_again(router: Router, packed: Path, tmp_path: Path) -> None:
    bundle = described(packed, 20_000)
    parts = Parts(tmp_path / "parts")
    with joined(router) as ours, joined(router) as theirs:
        with offered(ours, packed, bundle) as sent:
            for part in bundle.parts[:3]:  # as if it had been cut off there
                parts.put(part, packed.read_bytes()[20_000 * bundle.parts.index(part) :][:20_000])
            (parts.folder / bundle.parts[1]).write_bytes(b"torn")
            fetched(theirs, "", bundle, parts)
            assert sent() == bundle.length - 2 * 20_000
        parts.joined(bundle, tmp_path / "whole")
        assert (tmp_path / "whole").read_bytes() == packed.read_bytes()


def test_a_part_that_is_not_what_its_hash_says_is_not_taken(router: Router, packed: Path, tmp_path: Path) -> None:
    bundle = described(packed, 20_000)
    changed = tmp_path / "changed"
    changed.write_bytes(packed.read_bytes()[:30_000] + b"x" + packed.read_bytes()[30_001:])
    parts = Parts(tmp_path / "parts")
    refused = pytest.raises(PartMissing, match=r"nobody offers part .* \(20000 bytes are here\)")
    with joined(router) as ours, joined(router) as theirs, offered(ours, changed, bundle), refused:
        fetched(theirs, "", bundle, parts, patience=0.3)


def test_a_sites_cache_gets_one_copy_for_all_its_boards(router: Router, packed: Path, tmp_path: Path) -> None:
    bundle = described(packed, 20_000)
    with joined(router) as ours, joined(router) as near, joined(router) as board, offered(ours, packed, bundle) as sent:
        cache = Cache(near, "lab", tmp_path / "cache")
        querier = board.declare_querier(part_key("lab", "*", "*"))
        until(lambda: querier.matching_status.matching)  # a board that has not heard of it yet asks who sends
        for number in range(3):
            fetched(board, "lab", bundle, Parts(tmp_path / f"board{number}"))
        cache.close()  # the last answer is counted after it has come
        assert (sent(), cache.fetched, cache.handed) == (bundle.length, bundle.length, 3 * bundle.length)


def test_without_a_cache_boards_of_a_site_ask_who_sends(router: Router, packed: Path, tmp_path: Path) -> None:
    bundle = described(packed)
    with joined(router) as ours, joined(router) as board, offered(ours, packed, bundle) as sent:
        fetched(board, "lab", bundle, Parts(tmp_path / "board"))
        assert sent() == bundle.length


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where boards put what they import, a folder for each."""
    return tmp_path_factory.mktemp("imported")


@pytest.fixture(scope="module")
def boards(router: Router, places: Path) -> Iterator[dict[str, FleetBoard]]:
    """b1 takes archives, b2 signed ones, b3 none; anna may provision."""
    (places / "signers").mkdir()
    strict = places / "strict.yaml"
    strict.write_text(json.dumps({"policy": {"signatures": "require", "signers": str(places / "signers")}}))
    options = {
        "b1": ("--import-to", str(places / "b1"), "--after-import", "touch " + str(places / "reloaded")),
        "b2": ("--import-to", str(places / "b2"), "--settings", str(strict)),
        "b3": (),
    }
    with fleet_boards(("--router", router.endpoint), options, '{"zenoh:anna": provision, "*": operate}') as found:
        yield found


def test_boards_put_an_archive_in_force_as_their_policy_lets_them(
    boards: dict[str, FleetBoard], router: Router, packed: Path, places: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with cm.fleet.connect(router.endpoint, caller="anna", timeout=30.0) as fleet:
        until(lambda: fleet.boards() == tuple(boards), 60.0)
        found = fleet.push(packed)
        first, second, third = found["b1"], found["b2"], found["b3"]
        assert isinstance(first, BundleState)
        assert (first.config_name, first.error) == ("vision", None)
        assert (places / "b1" / "vision" / "edge.bin").read_bytes() == EDGE
        assert (places / "reloaded").exists()
        assert isinstance(second, BundleState)
        assert second.error is not None
        assert "not signed" in second.error.message
        assert not (places / "b2" / "vision").exists()
        assert isinstance(third, ErrorInfo)
        assert "start it with --import-to DIR" in third.message
    with cm.fleet.connect(router.endpoint, caller="bob", timeout=30.0) as other:
        refused = other.push(packed, ["b1"])["b1"]
    assert isinstance(refused, ErrorInfo)
    assert refused.code == "forbidden"
    assert main(["fleet", "push", str(packed), "b1", "--as", "anna", "--router", router.endpoint]) == 0
    assert "vision" in capsys.readouterr().out


MINI = """
config:
  name: mini
  modules:
    edge: {bitstream: edge.bit, region: prr0}
  regions: {prr0: {decoupler: {base_address: 0x1000, offset: 0x0, bit: 0}}}
  modes:
    contours: {modules: [edge]}
"""


def test_a_configuration_is_sent_in_parts_by_any_client_and_loaded(
    boards: dict[str, FleetBoard], router: Router
) -> None:
    """With zenoh and the messages of cm.proto alone."""
    board = boards["b3"]
    with joined(router) as plain:

        def done(verb: str, message: Any, data: bytes | None = None) -> Any:
            sent = message.SerializeToString()
            beside = {} if data is None else {"attachment": sent}
            (reply,) = plain.get(f"cm/b3/do/{verb}/anna", payload=sent if data is None else data, timeout=60, **beside)
            found = pb.Reply.FromString(bytes(reply.ok.payload))
            assert found.ok, found.error
            return found

        bitstream = next(board.sim.root.rglob("edge.bit")).read_bytes()
        for offset in range(0, len(bitstream), 100_000):
            part = bitstream[offset : offset + 100_000]
            upload = pb.Upload(id="edge", length=len(bitstream), offset=offset)
            assert done("upload", upload, part).upload.offset == offset + len(part)
        sha256 = hashlib.sha256(bitstream).hexdigest()
        file = pb.File(name="edge.bit", length=len(bitstream), sha256=sha256, upload="edge")
        done("provision", pb.WriteConfig(schema=MINI, files=[file], provision_only=True))
        done("mode", pb.WriteConfig(config_name="mini", mode="contours"))
        assert board.place == ("mini", "contours")
