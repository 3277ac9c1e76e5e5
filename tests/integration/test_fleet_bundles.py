# SPDX-License-Identifier: Apache-2.0
"""Archives to many boards: over each link once, resumed and checked. What boards do with them is in test_fleet.py."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fleet_support import VISION, Router

from cm.networks.fleet.bundles import PartMissing, Parts, described, fetched, offered
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
            fetched(theirs, bundle, parts)
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
        fetched(theirs, bundle, parts, patience=0.3)
