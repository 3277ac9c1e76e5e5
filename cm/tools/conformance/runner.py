# SPDX-License-Identifier: Apache-2.0
"""Runs cases against a driver: a program by the client's author, which does what lines of JSON tell it to."""

from __future__ import annotations

import json
import subprocess
import tempfile
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import zmq

from cm.errors import CmError
from cm.tools.conformance.acting_manager import ActingManager, ServerKeys
from cm.tools.conformance.client_cases import AnyError, Case

_HUNG = 60.0  # seconds beyond a case's own time-outs


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of a case: "passed", "failed", or "left out" if the driver cannot do what is asked."""

    name: str
    says: str
    result: str
    why: str = ""


class DriverGone(CmError):
    """The driver ended, or answered with what is not a line of JSON."""

    code = "driver"


class Driver:
    """The program; it gets a line for each case, and answers with one."""

    def __init__(self, command: Sequence[str]) -> None:
        self._process = subprocess.Popen(
            list(command), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )

    @property
    def pid(self) -> int:
        """The number of its process."""
        return self._process.pid

    @property
    def ended(self) -> bool:
        """Whether it has ended."""
        return self._process.poll() is not None

    def ask(self, line: dict[str, Any], seconds: float) -> list[Any]:
        """Results, in the order of the actions. Raises DriverGone."""
        alarm = threading.Timer(seconds, self._process.kill)
        alarm.start()
        try:
            _stream(self._process.stdin).write(json.dumps(line) + "\n")
            answer = _stream(self._process.stdout).readline()
        except OSError as error:
            raise DriverGone(f"the driver ended: {error}") from error
        finally:
            alarm.cancel()
        try:
            results = json.loads(answer)["results"]
        except (ValueError, KeyError, TypeError):
            said = answer.strip() or "nothing: it ended, or did not answer in time"
            raise DriverGone(f'the driver\'s answer should be {{"results": […]}}, and was {said[:200]}') from None
        return list(results)

    def close(self) -> None:
        """End it."""
        _stream(self._process.stdin).close()
        try:
            self._process.wait(60)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        _stream(self._process.stdout).close()


def _stream(stream: IO[str] | None) -> IO[str]:
    assert stream is not None
    return stream


def run(command: Sequence[str], chosen: Iterator[Case]) -> Iterator[Outcome]:
    """Run each case with a process of its own for the driver, so that one that crashes affects no other case."""
    for case in chosen:
        driver = Driver(command)
        try:
            yield _run(driver, case)
        except DriverGone as error:
            yield Outcome(case.name, case.says, "failed", str(error))
        finally:
            driver.close()


def _run(driver: Driver, case: Case) -> Outcome:
    with tempfile.TemporaryDirectory(prefix="cm-c-") as folder:
        server, client = _keys(case, Path(folder))
        with ActingManager(Path(folder), case.play, case.listens, server) as manager:
            place = {"endpoint": manager.endpoint, "keys": client} if server else {"folder": folder}
            line = {"case": case.name, "connect": place, "timeout": case.timeout, "do": list(case.do)}
            results = driver.ask(line, _HUNG + case.timeout * len(case.do))
        why = _complaint(case, results) or "; ".join(manager.violations) or case.check(manager.taken)
    if any(isinstance(r, dict) and r.get("unsupported") for r in results):
        return Outcome(case.name, case.says, "left out", "the driver cannot do this")
    return Outcome(case.name, case.says, "failed" if why else "passed", why)


def _complaint(case: Case, results: list[Any]) -> str:
    if len(results) != len(case.want):
        return f"{len(case.want)} results are wanted, and {len(results)} came"
    for number, (want, have) in enumerate(zip(case.want, results, strict=True)):
        if not _same(want, have):
            return f"result {number}: {want!r} is wanted, {have!r} came"
    return ""


def _same(want: Any, have: Any) -> bool:
    """Integers may be text, as some languages' numbers would lose digits; anything else a driver adds is ignored."""
    if isinstance(want, AnyError):
        return isinstance(have, dict) and bool(have.get("error"))
    if isinstance(want, dict):
        return isinstance(have, dict) and all(k in have and _same(v, have[k]) for k, v in want.items())
    if isinstance(want, list):
        return isinstance(have, list) and len(want) == len(have) and all(map(_same, want, have))
    if isinstance(want, int) and not isinstance(want, bool):
        return not isinstance(have, bool) and str(have) == str(want)
    return bool(want == have)


def _keys(case: Case, folder: Path) -> tuple[ServerKeys | None, str]:
    if not case.keys:
        return None, ""
    (public, secret), (ours, hidden), (other, _) = (zmq.curve_keypair() for _ in range(3))
    known = ours if case.keys == "known" else other
    path = folder / "client.key"
    pairs = {"server-public": public, "public": ours, "secret": hidden}
    path.write_text("# client\n" + "".join(f"{k}: {v.decode()}\n" for k, v in pairs.items()), encoding="ascii")
    return ServerKeys(public, secret, frozenset({known})), str(path)
