# SPDX-License-Identifier: Apache-2.0
"""Run the blocks of a Markdown page as a reader would: in order, in one shell and one Python, in an empty folder.

How a page says what is to be done with a block (CONTRIBUTING.md has the same for writers):

    ```sh               commands; each has to end with 0
    ```console          lines after `$ ` are commands; what stands below one is what it prints, `…` is anything
    ```python           of one session, which has the shell's environment
    # mine/name.yaml    as the first line of a block (`//` in Verilog and C): the block is saved as that file
    ```yaml, ```json    otherwise: has to be one
    <!-- not run: … --> above a block: it cannot run, for this reason; `none run` at the top of a page: none of them;
                        `none run of X` at the top: none that begins with the line `# X`
    <!-- suite: … -->   at the top: what the page needs is in this further suite
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import select
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import yaml
from manager_process import REPOSITORY, short_folder

PATIENCE = 240.0  # seconds for a block; most end within one
_FENCE = re.compile(r"^(?P<in> *)```(?P<kind>[\w{}-]*)[^\n]*\n(?P<text>.*?)^(?P=in)```$", re.MULTILINE | re.DOTALL)
_REASON = re.compile(r"<!-- not run: ([^>]+) -->\s*\Z")
_NONE = re.compile(r"^<!-- none run: ([^>]+) -->$", re.MULTILINE)
_NONE_OF = re.compile(r"^<!-- none run of (\w+): ([^>]+) -->$", re.MULTILINE)
_SUITE = re.compile(r"^<!-- suite: (\w+) -->$", re.MULTILINE)
_NAME = re.compile(r"\A(?:#|//) (\S+\.\w+)\n")
_PYTHON = """
import json, sys, traceback
names = {"__name__": "__main__"}
for line in sys.stdin:
    text, name = json.loads(line)
    try:
        exec(compile(text, name, "exec"), names)
        told = 0
    except BaseException:
        traceback.print_exc()
        told = 1
    sys.stderr.flush()
    print(f"\\n<<end {told}>>", flush=True)
"""


@dataclass(frozen=True, slots=True)
class Block:
    """A block of a page: where it begins, its language, its text, and why it cannot run ("" if it can)."""

    line: int
    kind: str
    text: str
    reason: str = ""


class PageFailed(AssertionError):
    """A block did not do what the page says; the text has the page, the line and what was printed."""


def blocks(page: str) -> list[Block]:
    """All blocks of a page, in order."""
    none, none_of = _NONE.search(page), _NONE_OF.search(page)

    def reason(found: re.Match[str]) -> str:
        if none_of and found["text"].startswith(f"# {none_of[1]}\n"):
            return none_of[2]
        above = none or _REASON.search(page, 0, found.start())
        return above[1] if above else ""

    return [
        Block(
            page.count("\n", 0, found.start()) + 1,
            found["kind"],
            re.sub(f"^{found['in']}", "", found["text"], flags=re.MULTILINE),
            reason(found),
        )
        for found in _FENCE.finditer(page)
    ]


def suite(page: str) -> str:
    """The further suite that has what the page needs; "plain" if README's packages do."""
    found = _SUITE.search(page)
    return found[1] if found else "plain"


def indented(page: str) -> list[int]:
    """Lines at which a block begins that is indented only, and thus says no language."""
    text = _FENCE.sub(lambda found: re.sub(r"[^\n]+", "x", found[0]), page)
    return [
        text.count("\n", 0, found.end()) + 1
        for found in re.finditer(r"^(?![ ]*[-*\d]).*\n\n(?=    \S)", text, re.MULTILINE)
    ]


class _Session:
    """A program that takes text and says when it has done it."""

    def __init__(self, command: list[str], folder: Path, env: dict[str, str]) -> None:
        self._process = subprocess.Popen(
            command,
            cwd=folder,
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in: IO[bytes] = self._process.stdin
        self._out: IO[bytes] = self._process.stdout

    def do(self, text: str) -> tuple[int, str]:
        """The status with which it ended, and what was printed meanwhile."""
        self._in.write(text.encode())
        self._in.flush()
        said, end = b"", time.monotonic() + PATIENCE
        while not (found := re.search(rb"\n?<<end (\d+)>>\n", said)):
            if not select.select([self._out], [], [], max(0.0, end - time.monotonic()))[0]:
                return -1, said.decode(errors="replace") + "\n(nothing more came in time)"
            if not (more := os.read(self._out.fileno(), 1 << 16)):
                return -1, said.decode(errors="replace") + "\n(it ended)"
            said += more
        return int(found[1]), (said[: found.start()] + said[found.end() :]).decode(errors="replace")

    def close(self) -> None:
        """End it, and whatever it started and did not end itself."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait(timeout=20)
        self._in.close()
        self._out.close()


@contextlib.contextmanager
def reader(folder: Path, env: dict[str, str]) -> Iterator[Reader]:
    """Somebody who reads pages in `folder`."""
    with contextlib.ExitStack() as stack:
        yield Reader(folder, env, stack)


class Reader:
    """Runs blocks; a page's shell and its Python last as long as the reader."""

    def __init__(self, folder: Path, env: dict[str, str], stack: contextlib.ExitStack) -> None:
        self._folder, self._env, self._stack = folder, env, stack
        self._shell = self._session(["bash", "--norc", "--noprofile"], env)
        self._python: _Session | None = None
        stack.callback(
            self._shell.do, "trap '' TERM; kill $(jobs -p); wait; echo '<<end 0>>'\n"
        )  # boards go with managers

    def _session(self, command: list[str], env: dict[str, str]) -> _Session:
        session = _Session(command, self._folder, env)
        self._stack.callback(session.close)
        return session

    def run(self, block: Block, name: str) -> None:
        """Do what a block says. Raises PageFailed."""
        if block.reason:
            return
        try:
            self._run(block)
        except PageFailed as failed:
            raise PageFailed(f"{name}:{block.line}: {failed}\n{block.text}") from None

    def _run(self, block: Block) -> None:
        if named := _NAME.match(block.text):
            path = self._folder / named[1]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, "utf-8")
        elif block.kind == "sh":
            self._commands(block.text)
        elif block.kind == "console":
            for command, printed in _dialogue(block.text):
                _compare(command, printed, self._commands(command))
        elif block.kind == "python":
            self._lines(block.text, f"line {block.line}")
        elif block.kind == "yaml":
            yaml.safe_load(block.text)
        elif block.kind == "json":
            json.loads(block.text)
        elif block.kind not in ("text", "mermaid", "{toctree}"):
            raise PageFailed(f"nothing is known of ```{block.kind}: say why it does not run")

    def _commands(self, text: str) -> str:
        script = f"failed=0; trap 'failed=$?; echo \"status $failed: $BASH_COMMAND\"' ERR\n{text}\ntrap - ERR\n"
        status, said = self._shell.do(f'{script}echo "<<end $failed>>"\n')
        if status:
            raise PageFailed(f"a command failed:\n{said}")
        return said

    def _lines(self, text: str, name: str) -> None:
        if self._python is None:
            _, said = self._shell.do("env -0 | base64 -w0; echo; echo '<<end 0>>'\n")
            decoded = subprocess.run(["base64", "-d"], input=said.encode().split()[-1], capture_output=True, check=True)
            env = dict(pair.split("=", 1) for pair in decoded.stdout.decode().split("\0") if "=" in pair)
            self._python = self._session([sys.executable, "-W", "error", "-c", _PYTHON], env)
        status, said = self._python.do(json.dumps([text, name]) + "\n")
        if status:
            raise PageFailed(f"Python says:\n{said}")


def _dialogue(text: str) -> list[tuple[str, list[str]]]:
    """Commands of a block for people, each with the lines below it."""
    parts: list[tuple[str, list[str]]] = []
    for line in text.splitlines():
        if line.startswith("$ "):
            parts.append((line[2:], []))
        elif parts:
            parts[-1][1].append(line)
    return parts


def _compare(command: str, wanted: list[str], said: str) -> None:
    """What the page shows was printed: in this order, where numbers may be others and `…` stands for anything."""
    lines = iter([_plain(line) for line in said.splitlines()])
    for line in wanted:
        if line.strip() not in ("", "…") and not any(re.fullmatch(_pattern(line), other) for other in lines):
            raise PageFailed(f"`{command}` did not print: {line}\nbut:\n{said}")


def _plain(line: str) -> str:
    return re.sub(r"\d[\d.,]*", "0", " ".join(line.split()))


def _pattern(line: str) -> str:
    return ".*".join(re.escape(_plain(part)) for part in line.split("…"))


def installed(folder: Path, repository: Path) -> dict[str, str]:
    """The environment of a person in `folder`, where the package is installed in `.venv`, and active."""
    tools = folder / ".venv/bin"
    tools.mkdir(parents=True)
    (tools / "activate").write_text(f"export PATH={shlex.quote(str(tools))}:$PATH\n")
    for name, arguments in (("cm", ' -m cm "$@"'), ("python", ' "$@"'), ("pytest", ' -m pytest "$@"')):
        (tools / name).write_text(f"#!/bin/sh\nexec {shlex.quote(sys.executable)}{arguments}\n")
        (tools / name).chmod(0o755)
    (folder / "run").mkdir(mode=0o700)
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("CM_", "PYTEST_", "XDG_"))}
    return {
        **kept,
        "PATH": f"{tools}:{os.environ['PATH']}",
        "PYTHONPATH": str(repository),
        "HOME": str(folder),
        "CM_RUNTIME_DIR": str(folder / "run"),  # as root has one place for all
        "XDG_CACHE_HOME": os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache")),
        "TERM": "dumb",
    }


def read(page: str, name: str) -> None:
    """Do all that a page says, in an empty folder. Raises PageFailed."""
    with short_folder() as folder, reader(folder, installed(folder, REPOSITORY)) as person:
        for block in blocks(page):
            person.run(block, name)
