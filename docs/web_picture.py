# SPDX-License-Identifier: Apache-2.0
"""Write ``images/web.webp``, the page of `cm web` on the camera example.

After `make test-web`: ``.venv/bin/python docs/web_picture.py``.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Any

from PIL import Image

DOCS = Path(__file__).resolve().parent
PICTURE = DOCS / "images" / "web.webp"
sys.path[:0] = [str(DOCS.parent), str(DOCS.parent / "tests")]

from manager_process import served  # noqa: E402 (of the tests, which start the same)
from web_support import change, chromium, page_of, watch, web_server  # noqa: E402

_SECONDS = 50  # of history, so that there is something to see over time


def _use(page: Any, board: Any) -> None:
    """What somebody may do in a minute."""
    watch(page)
    for step, mode in enumerate(
        ("edge_detection", "colorise", "default", "loopback_edge", "colorise", "edge_detection")
    ):
        page.wait_for_timeout(_SECONDS * 1000 / 6)
        change(page, mode)
        board.registers.write({"led.pattern": 1 << step % 4, "led.blink": step % 3})
    page.wait_for_timeout(2500)


def main() -> None:
    """Take it."""
    with (
        served(arguments=["--name", "zybo-lab-3"], board=["--hold", "400"]) as (manager, _),
        web_server(manager.runtime, "--control") as server,
        chromium() as browser,
        page_of(browser, server, width=1660, height=1040, color_scheme="dark") as page,
        manager.connected() as board,
    ):
        board.load("camera", "default")
        with board.lease("registers:led", exclusive=False, seconds=600, holder="calibration"):
            _use(page, board)
            data = page.screenshot()
    with Image.open(io.BytesIO(data)) as picture:
        picture.convert("RGB").save(PICTURE, "WEBP", quality=80, method=6)
    print(f"{PICTURE}: {PICTURE.stat().st_size >> 10} KiB")


if __name__ == "__main__":
    main()
