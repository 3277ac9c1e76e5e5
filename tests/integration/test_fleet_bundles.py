# SPDX-License-Identifier: Apache-2.0
"""Archives to many boards: over each link once, resumed and checked. What boards do with them is in test_fleet.py."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fleet_support import VISION, Router
from manager_process import until

from cm.networks.fleet.bundles import Cache, PartMissing, Parts, described, fetched, offered, part_key
from cm.networks.fleet.network import Network, session

pytestmark = pytest.mark.networks


@pytest.fixture(scope="module")
def router() -> Iterator[Router]:
    found = Router()
    yield found
    found.kill()


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sent") / "vision.tar.gz"
    path.write_bytes(VISION)
    return path


def joined(router: Router) -> Any:
    return session(Network(connect=(router.endpoint,)))


def test_parts_that_have_arrived_are_not_fetched_again(router: Router, packed: Path, tmp_path: Path) -> None:
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


def test_a_part_with_a_wrong_hash_is_not_accepted(router: Router, packed: Path, tmp_path: Path) -> None:
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
        until(lambda: querier.matching_status.matching)  # a board that has not discovered it yet asks the sender
        for number in range(3):
            fetched(board, "lab", bundle, Parts(tmp_path / f"board{number}"))
        cache.close()  # the last answer is counted after it has come
        assert (sent(), cache.fetched, cache.handed) == (bundle.length, bundle.length, 3 * bundle.length)


def test_without_a_cache_boards_of_a_site_ask_the_sender(router: Router, packed: Path, tmp_path: Path) -> None:
    bundle = described(packed)
    with joined(router) as ours, joined(router) as board, offered(ours, packed, bundle) as sent:
        fetched(board, "lab", bundle, Parts(tmp_path / "board"))
        assert sent() == bundle.length
