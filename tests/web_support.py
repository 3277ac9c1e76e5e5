# SPDX-License-Identifier: Apache-2.0
"""``cm web`` as a process, and the browser that looks at it: Debian's chromium, driven by playwright."""

from __future__ import annotations

import contextlib
import select
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
import yaml
from manager_process import CAMERA, environment

from cm import child

WAIT = 60_000  # milliseconds, as playwright has them: a guard against hanging
SWITCHES = ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]


class WebServer:
    """A `cm web` process."""

    def __init__(self, runtime: Path | None, *arguments: str) -> None:
        """`runtime` None: the arguments say which manager."""
        where = () if runtime is None else ("--runtime-dir", str(runtime))
        command = child.command("cm.cli.main", "web", *where, "--listen", "0", *arguments)
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, env=environment(), cwd="/")
        assert self.process.stderr is not None
        ready, _, _ = select.select([self.process.stderr], [], [], 60)
        line = self.process.stderr.readline().decode() if ready else ""
        assert line.startswith("cm web: http://"), f"the server did not start: {line}"
        self.url = line.removeprefix("cm web: ").strip()
        self.origin, _, self.token = self.url.partition("/#token=")
        self.host = urlsplit(self.origin).netloc

    def stop(self) -> tuple[int, str]:
        """Stop it; return its exit status and its stderr."""
        self.process.send_signal(signal.SIGTERM)
        _, said = self.process.communicate(timeout=60)
        return self.process.returncode, said.decode()

    def resident(self) -> int:
        """KiB of its own memory, without mapped slots, whose number depends on speed."""
        text = Path(f"/proc/{self.process.pid}/status").read_text(encoding="ascii")
        return int(text.partition("RssAnon:")[2].split()[0])

    def descriptors(self) -> int:
        return len(list(Path(f"/proc/{self.process.pid}/fd").iterdir()))


@contextlib.contextmanager
def web_server(runtime: Path | None, *arguments: str) -> Iterator[WebServer]:
    server = WebServer(runtime, *arguments)
    try:
        yield server
    finally:
        status, said = server.stop()
    assert (status, said) == (0, ""), f"cm web ended with {status} and said: {said}"


@contextlib.contextmanager
def chromium() -> Iterator[Any]:
    """A browser; skips where there is none."""
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright, of the extra [test-web]")
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("needs chromium: apt install chromium")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=SWITCHES)
        yield browser
        browser.close()


@contextlib.contextmanager
def page_of(
    browser: Any, server: WebServer, url: str = "", width: int = 1680, height: int = 1050, **options: Any
) -> Iterator[Any]:
    """A page of its own, connected unless another `url` is given; what it logs as an error fails the test."""
    context = browser.new_context(viewport={"width": width, "height": height}, locale="en-GB", **options)
    context.set_default_timeout(WAIT)
    page = context.new_page()
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.goto(url or server.url)
    if not url:
        page.wait_for_selector("body[data-link=up]")
    yield page
    context.close()
    assert [error for error in errors if "WebSocket" not in error] == []


def watch(page: Any, stream: str = "camera") -> None:
    """Look at a stream, and wait for its frames."""
    card = f"article[data-stream={stream}]"
    if page.get_attribute(card, "data-watched") != "true":
        page.click(f"{card} button")
    page.wait_for_selector(f"{card}[data-live=true]")


def change(page: Any, mode: str) -> None:
    """Change the mode by a click, and wait until the board is there."""
    page.click(f"li[data-mode={mode}] .go")
    page.wait_for_selector(f"li[data-mode={mode}][data-here=true]")
    page.wait_for_selector("#state[data-state=idle]")


_KINDS = {
    "gain": "{}",
    "packets_counted": "{access: ro, volatile: true}",
    "prefetch_threshold_high": "{default: 3, min: 0, max: 4095}",
    "fifo_status": "{access: ro, volatile: true, fields: {full: {bits: 0}, level: {bits: '19:8'}, "
    "state: {bits: '3:1', values: {idle: 0, run: 1, drain: 2}}}}",
    "control": "{fields: {enable: {bits: 0, doc: Lets data through.}, invert: {bits: 1}, "
    "mode: {bits: '3:2', values: {bypass: 0, wrap: 1, saturate: 2}}}}",
}


def crowded(folder: Path) -> Path:
    """The camera example, in `folder`, with sixty more registers of long names and all kinds."""
    schema = yaml.safe_load((CAMERA / "camera.yaml").read_text("utf-8"))["config"]
    homes = {"system": (schema, 0x1000, 0x100), "capture": (schema, 0x2000, 0x100)}
    homes["edge_filter"] = (schema["modules"]["edge"], 0x2000, 0x200)
    for prefix, (home, base, offset) in homes.items():
        window = next(one for one in home["mmio"] if one["base_address"] == base)
        names = [(f"{prefix}_{name}_{number}", kind) for number in range(4) for name, kind in _KINDS.items()]
        for place, (name, kind) in enumerate(names):
            window["registers"][name] = {"offset": offset + 4 * place, **yaml.safe_load(kind)}
    (folder / "crowded").mkdir()
    (folder / "crowded/camera.yaml").write_text(yaml.safe_dump({"config": schema}, sort_keys=False), "utf-8")
    return folder / "crowded"
