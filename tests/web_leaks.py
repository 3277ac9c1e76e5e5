# SPDX-License-Identifier: Apache-2.0
"""Changes of mode by clicks, and what they leave behind in the browser and in the page's server."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle, islice
from typing import Any

from web_support import WebServer

MODES = ("edge_detection", "colorise", "default")


@dataclass(frozen=True)
class Held:
    """After garbage collection: bytes of JavaScript, elements, listeners; KiB and descriptors of the server."""

    heap: int
    nodes: int
    listeners: int
    resident: int
    descriptors: int


def held(page: Any, server: WebServer) -> Held:
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable")
    for _ in range(3):
        session.send("HeapProfiler.collectGarbage")
    found = {metric["name"]: int(metric["value"]) for metric in session.send("Performance.getMetrics")["metrics"]}
    session.detach()
    heap, nodes, listeners = (found[name] for name in ("JSHeapUsedSize", "Nodes", "JSEventListeners"))
    return Held(heap, nodes, listeners, server.resident(), server.descriptors())


_CLICKS = """async (modes) => {
    const mode = (name) => document.querySelector(`li[data-mode=${name}]`);
    const is = (condition) => new Promise((done) => {
        const look = () => condition() && (watcher.disconnect(), done());
        const watcher = new MutationObserver(look);
        watcher.observe(document.body, { subtree: true, childList: true, attributes: true });
        look();
    });
    for (const name of modes) {
        await is(() => mode(name).querySelector(".go").ariaDisabled !== "true");
        mode(name).querySelector(".go").click();
        await is(() => mode(name).dataset.here === "true");
    }
}"""


def changed(page: Any, count: int) -> None:
    """Make changes by clicks; the board is in its default mode before, and in another one afterwards."""
    page.evaluate(_CLICKS, list(islice(cycle(MODES), count)))
