# SPDX-License-Identifier: Apache-2.0
"""A control request beside a bare REQ/REP of the same bytes."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from cm.client.core.calls import read_registers
from cm.tools.bench.peer import Peer
from cm.tools.bench.peers import zmq_board, zmq_reply
from cm.tools.bench.result import Goal, Result
from cm.tools.bench.rounds import Batch, Samples, interleave, timed
from cm.tools.bench.run import Run
from cm.tools.bench.serving import Served, serve, settle
from cm.wire.encode import encode_request
from cm.wire.messages.requests import ReadReg, ReadStatus, Request

REGISTER = "focus"
RAN = (
    "cm_read_reg of one register by a REQ socket, manager on the simulated board, whose registers are read as memory; "
    "baseline: pyzmq REQ/REP over ipc with the same frames"
)


def run(bench: Run) -> list[Result]:
    """Measure `control_vs_zmq`."""
    with ExitStack() as stack:
        served = stack.enter_context(serve(bench))
        board = stack.enter_context(served.connect())
        settle(board)
        read = asking(stack, served, ReadReg((REGISTER,)))
        status = asking(stack, served, ReadStatus())
        question = read_registers((REGISTER,))
        register = next(r for r in board.config().registers if r.name == REGISTER)
        place = same_bytes(bench, read)
        zmq_board.put_register(place, served.runtime_dir / "board", register.address, register.width)
        contestants: dict[str, Batch] = {
            "bare": timed(stack.enter_context(Peer("zmq_reply", same_bytes(bench, read), 0)).trip),
            "bare_with_access": timed(stack.enter_context(Peer("zmq_board", place, 0)).trip),
            "bare_status": timed(stack.enter_context(Peer("zmq_reply", same_bytes(bench, status), 0)).trip),
            "cm_read_reg": timed(read.trip),
            "cm_status": timed(status.trip),
            "client": timed(lambda: board.ask(question)),
        }
        return [_result(interleave(contestants, bench.plan(200)))]


def asking(stack: ExitStack, served: Served, request: Request) -> zmq_reply.Asking:
    """A client over a bare REQ socket, that asks for one thing."""
    frames = [bytes(frame) for frame in encode_request(request)]
    asking = zmq_reply.Asking(f"ipc://{served.runtime_dir}/req", frames)
    stack.callback(asking.close)
    return asking


def same_bytes(bench: Run, asking: zmq_reply.Asking) -> Path:
    """Where a peer finds the frames of a request and of its reply."""
    place = bench.place("r")
    zmq_reply.put(place, asking.request, asking.trip())
    return place


def _result(samples: dict[str, Samples]) -> Result:
    value, bare = samples["cm_read_reg"], samples["bare"]
    return Result(
        "control_vs_zmq",
        value.median,
        "µs",
        RAN,
        baseline=bare.median,
        ratio=value.over(bare),
        goal=Goal(1.5),
        details={
            "ratio_to_bare_with_the_same_access": value.over(samples["bare_with_access"]),
            "status_ratio": samples["cm_status"].over(samples["bare_status"]),
            "client_ratio": samples["client"].over(bare),
            "samples": {name: found.plain() for name, found in samples.items()},
        },
    )
