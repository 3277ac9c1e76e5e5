# SPDX-License-Identifier: Apache-2.0
"""Archives to many boards: over each link once, resumed and checked. What boards do with them is in test_fleet.py."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fleet_support import VISION, Router
from manager_process import until

from cm.networks.fleet.bundles import BundleMissing, Pace, described, fetched, offered
from cm.networks.fleet.zenoh_session import Network, session

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


def test_pieces_that_have_arrived_are_not_fetched_again(router: Router, packed: Path, tmp_path: Path) -> None:
    bundle, here = described(packed), tmp_path / "here"
    here.write_bytes(packed.read_bytes()[:45_000])
    with joined(router) as ours, joined(router) as theirs, offered(ours, packed, bundle) as sent:
        fetched(theirs, bundle, here)
        assert sent() == bundle.length - 45_000
        assert here.read_bytes() == packed.read_bytes()
        here.write_bytes(b"torn" + packed.read_bytes()[4:])
        with pytest.raises(BundleMissing, match="is not the archive that was announced"):
            fetched(theirs, bundle, here)
        fetched(theirs, bundle, here)  # from the beginning
    assert here.read_bytes() == packed.read_bytes()


def test_an_archive_that_became_another_or_shorter_is_not_accepted(
    router: Router, packed: Path, tmp_path: Path
) -> None:
    bundle, changed, here = described(packed), tmp_path / "changed", tmp_path / "here"
    changed.write_bytes(packed.read_bytes()[:30_000] + b"x" + packed.read_bytes()[30_001:])
    with joined(router) as ours, joined(router) as theirs, offered(ours, changed, bundle):
        with pytest.raises(BundleMissing, match="is not the archive that was announced"):
            fetched(theirs, bundle, here)
        changed.write_bytes(packed.read_bytes()[:2560])
        with pytest.raises(BundleMissing, match=r"nobody offers it any more \(2560 bytes are here\)"):
            fetched(theirs, bundle, here, patience=0.3)


def test_a_piece_is_as_long_as_comes_in_a_fifth_of_a_second_and_never_much_longer_than_the_last() -> None:
    pace, lengths = Pace(), []
    for rate in (8_000, 8_000, 1e6, 1e6, 1e6, 1e9, 1e5, 100):  # bytes a second
        lengths.append(pace.length)
        pace.took(pace.length, pace.length / rate)
    assert lengths == [2560, 2560, 2560, 5120, 10240, 20480, 40960, 20000]
    assert pace.length == 2560


def test_nothing_is_fetched_while_a_change_is_open(router: Router, packed: Path, tmp_path: Path) -> None:
    bundle, here = described(packed), tmp_path / "here"
    busy = threading.Event()
    with joined(router) as ours, joined(router) as theirs, offered(ours, packed, bundle) as sent:
        busy.set()
        work = threading.Thread(target=fetched, args=(theirs, bundle, here), kwargs={"busy": busy.is_set})
        work.start()
        until(here.exists)
        time.sleep(0.5)
        assert sent() == 0
        busy.clear()
        work.join(60.0)
    assert here.read_bytes() == packed.read_bytes()
