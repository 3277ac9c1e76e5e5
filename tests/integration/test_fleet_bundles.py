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
from fleet_support import Router, fleet_board
from manager_process import until

import cm.fleet
from cm.build.collect.layout import archive
from cm.cli.main import main
from cm.fleet.bundles import Cache, PartMissing, Parts, described, fetched, offered
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


@pytest.fixture
def packed(tmp_path: Path) -> Path:
    path = tmp_path / "vision.tar.gz"
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
    refused = pytest.raises(PartMissing, match=r"nobody hands out part .* \(20000 bytes are here\)")
    with joined(router) as ours, joined(router) as theirs, offered(ours, changed, bundle), refused:
        fetched(theirs, "", bundle, parts, patience=0.3)


def test_a_sites_cache_gets_one_copy_for_all_its_boards(router: Router, packed: Path, tmp_path: Path) -> None:
    bundle = described(packed, 20_000)
    with joined(router) as ours, joined(router) as near, joined(router) as board, offered(ours, packed, bundle) as sent:
        cache = Cache(near, "lab", tmp_path / "cache")
        for number in range(3):
            fetched(board, "lab", bundle, Parts(tmp_path / f"board{number}"))
        assert (sent(), cache.fetched, cache.handed) == (bundle.length, bundle.length, 3 * bundle.length)
        cache.close()


def test_without_a_cache_boards_of_a_site_ask_who_sends(router: Router, packed: Path, tmp_path: Path) -> None:
    bundle = described(packed)
    with joined(router) as ours, joined(router) as board, offered(ours, packed, bundle) as sent:
        fetched(board, "lab", bundle, Parts(tmp_path / "board"))
        assert sent() == bundle.length


def test_boards_put_an_archive_in_force_as_their_policy_lets_them(
    router: Router, packed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    strict = tmp_path / "strict.yaml"
    (tmp_path / "signers").mkdir()
    strict.write_text(json.dumps({"policy": {"signatures": "require", "signers": str(tmp_path / "signers")}}))
    places = {name: tmp_path / name for name in ("b1", "b2")}
    options = {
        "b1": ("--import-to", str(places["b1"]), "--after-import", "touch " + str(tmp_path / "reloaded")),
        "b2": ("--import-to", str(places["b2"]), "--settings", str(strict)),
    }
    guests = '{"zenoh:anna": provision, "*": operate}'
    way = ("--router", router.endpoint)
    with (
        fleet_board("b1", way, options["b1"], guests=guests),
        fleet_board("b2", way, options["b2"], guests=guests),
        cm.fleet.connect(router.endpoint, caller="anna", timeout=30.0) as fleet,
    ):
        until(lambda: fleet.boards() == ("b1", "b2"), 60.0)
        found = fleet.push(packed)
        first, second = found["b1"], found["b2"]
        assert isinstance(first, BundleState)
        assert (first.config_name, first.error) == ("vision", None)
        assert (places["b1"] / "vision" / "edge.bin").read_bytes() == EDGE
        assert (tmp_path / "reloaded").exists()
        assert isinstance(second, BundleState)
        assert second.error is not None
        assert "not signed" in second.error.message
        assert not (places["b2"] / "vision").exists()
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


def test_a_configuration_is_sent_in_parts_by_any_client_and_loaded(router: Router) -> None:
    """With zenoh and the messages of cm.proto alone."""
    way = ("--router", router.endpoint)
    with fleet_board("b3", way, guests='{"zenoh:anna": provision}') as board, joined(router) as plain:

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
