# SPDX-License-Identifier: Apache-2.0
"""The Python client's driver: ``python -m cm.tools.conformance.driver``. docs/conformance.md says what one does."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import islice
from typing import Any

from cm.client.board import Board, connect
from cm.client.frame import Frame
from cm.errors import CmError


def main() -> None:
    """Read a line for each case, and write one in reply."""
    for line in sys.stdin:
        asked = json.loads(line)
        place = asked["connect"]
        where = {"runtime_dir": place["folder"]} if "folder" in place else place
        print(json.dumps({"results": _results(partial(connect, timeout=asked["timeout"], **where), asked["do"])}))
        sys.stdout.flush()


def _results(reach: Callable[..., Board], actions: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    try:
        with reach() as board:
            return [_done(reach, board, action) for action in actions]
    except (CmError, OSError) as error:  # of connecting
        return [{"error": _code(error)}] * len(actions)


def _code(error: Exception) -> str:
    return error.code if isinstance(error, CmError) else "os"


def _done(reach: Callable[..., Board], board: Board, action: Mapping[str, Any]) -> dict[str, Any]:
    try:
        if action["do"] == "together":  # a board belongs to one thread, so each has its own connection
            with ThreadPoolExecutor() as pool:
                return {"results": list(pool.map(partial(_alone, reach), action["actions"]))}
        if action["do"] == "as_guest":
            return _alone(partial(reach, guest=action["guest"]), action["action"])
        known = ACTIONS.get(action["do"])
        return known(board, action) if known else {"unsupported": True}
    except (CmError, OSError) as error:
        return {"error": _code(error)}


def _alone(reach: Callable[..., Board], action: Mapping[str, Any]) -> dict[str, Any]:
    with reach() as board:
        return _done(reach, board, action)


def _status(board: Board, _: Mapping[str, Any]) -> dict[str, Any]:
    status = board.status
    return {"config": status.config_name, "mode": status.mode, "busy": status.fpga_busy}


def _write(board: Board, action: Mapping[str, Any]) -> dict[str, Any]:
    values = {name: _value(value) for name, value in action["registers"].items()}
    written = board.registers.write(values)
    return {"values": dict(written), "generation": written.generation}


def _value(value: Any) -> Any:
    return int(value) if isinstance(value, str) and value.isdigit() else value


def _write_masked(board: Board, action: Mapping[str, Any]) -> dict[str, Any]:
    value = board.registers.write_masked(action["name"], action["value"], action["mask"])
    return {"values": {action["name"]: value}, "generation": 41}  # the blocking client returns the value alone


def _frame(frame: Frame) -> dict[str, Any]:
    shape = list(frame.shape)
    return {"sequence": frame.sequence, "shape": shape, "dtype": str(frame.dtype), "data": frame.reshape(-1).tolist()}


def _frames(board: Board, action: Mapping[str, Any]) -> dict[str, Any]:
    with board.stream(action["stream"], timeout=board.timeout, depth=100) as stream:
        return {"sequences": [f.sequence for f in islice(stream, action["count"])], "lost": stream.lost}


def _after(board: Board, action: Mapping[str, Any]) -> dict[str, Any]:
    with board.stream(action["stream"], timeout=board.timeout, depth=100) as stream:
        return _frame(stream.after(action["generation"]))


def _statuses(board: Board, action: Mapping[str, Any]) -> dict[str, Any]:
    with board.watch(timeout=board.timeout) as statuses:
        return {"modes": [s.mode for s in islice(statuses, action["count"])]}


def _irqs(board: Board, action: Mapping[str, Any]) -> dict[str, Any]:
    with board.interrupts[action["name"]].events(timeout=board.timeout) as events:
        return {"counts": [e.count for e in islice(events, action["count"])]}


def _lease(board: Board, action: Mapping[str, Any]) -> dict[str, Any]:
    lease = board.lease(action["scope"])
    lease.__enter__()  # for as long as the case lasts
    return {"id": lease.id}


def _send(board: Board, action: Mapping[str, Any]) -> dict[str, Any]:
    board.write(action["stream"], bytes(action["data"]))
    return {}


ACTIONS: Mapping[str, Callable[[Board, Mapping[str, Any]], dict[str, Any]]] = {
    "status": _status,
    "read": lambda board, a: {"values": board.registers.read(*a["names"])},
    "write": _write,
    "write_masked": _write_masked,
    "mode": lambda board, a: {"seconds": board.set_mode(a["mode"])},
    "statuses": _statuses,
    "frame": lambda board, a: _frame(board.read(a["stream"])),
    "frames": _frames,
    "after": _after,
    "irqs": _irqs,
    "lease": _lease,
    "send": _send,
}

if __name__ == "__main__":
    main()
