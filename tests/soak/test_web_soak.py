# SPDX-License-Identifier: Apache-2.0
"""A page that is open for a thousand changes of mode; `make soak` makes them, others a few."""

from __future__ import annotations

import pytest
from manager_process import served
from web_leaks import changed, held
from web_support import chromium, page_of, watch, web_server


@pytest.mark.elsewhere  # in short it is part of test_web_page.py
@pytest.mark.timeout(3600)
def test_a_page_grows_by_nothing_while_the_mode_changes(changes: int) -> None:
    count = min(changes // 10, 1000)
    if count < 100:
        pytest.skip("a hundred changes are part of test_web_page.py; make soak makes a thousand")
    with (
        served(board=["--icap-rate", "0"]) as (manager, _),
        web_server(manager.runtime, "--control") as server,
        chromium() as browser,
        page_of(browser, server, width=1000, height=700) as page,
    ):
        with manager.connected() as board:
            board.load("camera", "default")
        watch(page)
        changed(page, 60)
        before = held(page, server)
        changed(page, count)
        after = held(page, server)
    print(count, before, after)
    assert after.nodes <= before.nodes * 1.1
    assert after.listeners <= before.listeners * 1.1
    assert after.heap <= before.heap * 1.5
    assert after.resident <= before.resident + (8 << 10)
