# SPDX-License-Identifier: Apache-2.0
"""``cm conformance``: our clients and our manager pass, and clients with defects fail."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import pytest
from manager_process import REPOSITORY

from cm.cli.main import main
from cm.tools.conformance.client_cases import cases
from cm.tools.conformance.driver import ACTIONS

OURS = [sys.executable, "-m", "cm.tools.conformance.driver"]
HEADER = """
import json, sys
import zmq
from cm.wire import cm_pb2 as pb

asked = json.loads(sys.stdin.readline())
req = zmq.Context.instance().socket(zmq.DEALER)
req.linger, req.rcvtimeo = 0, 20000
req.connect(f"ipc://{asked['connect']['folder']}/req")

def say(*results):
    print(json.dumps({"results": results}), flush=True)

def values(frames):
    return {"values": {v.name: v.value for v in pb.Reply.FromString(frames[-1]).registers.values}}
"""
# A client that does one thing wrong, the case that shows it, and the message.
WRONG = {
    "a reply is taken for that of another request": ("late-reply", """
message = pb.ReadReg(names=["focus"]).SerializeToString()
req.send_multipart([b"", b"cm_read_reg", message])
req.send_multipart([b"", b"cm_read_reg", message])
say({"error": "timeout"}, values(req.recv_multipart()))
""", "result 1: .*'focus': 2.* is wanted"),
    "a mask of 0 is left out": ("write-masked", """
writes = [pb.RegWrite(name="focus", value=3)]
req.send_multipart([b"", b"cm_write_reg", pb.WriteReg(writes=writes).SerializeToString()])
say({**values(req.recv_multipart()), "generation": 41})
""", "it should have written .*mask=0"),
    "what is sent is not a message": ("status", """
req.send_multipart([b"", b"cm_status", b"\\xff\\xff"])
req.send_multipart([b"", b"cm_status", b""])
req.recv_multipart()
say({"config": "camera", "mode": "default", "busy": False})
""", "what was sent is not a request"),
    "digits are lost": ("write-64-bits", """
writes = [pb.RegWrite(name="wide", value=int(float((1 << 64) - 2048)))]
req.send_multipart([b"", b"cm_write_reg", pb.WriteReg(writes=writes).SerializeToString()])
say({"values": {"wide": values(req.recv_multipart())["values"]["wide"]}, "generation": 41})
""", "it should have written .*18446744073709551615"),
    "it says something else": ("mode", "print('hello', flush=True)", "should be .*results.*hello"),
    "it ends": ("mode", "", "nothing: it ended"),
}  # fmt: skip


def outcomes(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, list[dict[str, str]]]:
    status = main(["conformance", "--json", *arguments])
    return status, json.loads(capsys.readouterr().out)


def test_the_python_client_passes(capsys: pytest.CaptureFixture[str]) -> None:
    status, told = outcomes(capsys, "--", *OURS)
    assert [o for o in told if o["result"] != "passed"] == []
    assert (status, len(told)) == (0, len(list(cases())))


@pytest.mark.parametrize("wrong", WRONG)
def test_a_client_that_does_wrong_fails_with_the_reason(
    wrong: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case, does, says = WRONG[wrong]
    (tmp_path / "client.py").write_text(HEADER + does)
    status, [told] = outcomes(capsys, "--case", case, "--", sys.executable, str(tmp_path / "client.py"))
    assert (status, told["result"]) == (1, "failed")
    assert re.search(says, told["why"]), told["why"]


def test_what_a_client_cannot_do_is_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "client.py").write_text(HEADER + 'say({"unsupported": True})')
    status, [told] = outcomes(capsys, "--case", "interrupts", "--", sys.executable, str(tmp_path / "client.py"))
    assert (status, told["result"]) == (0, "left out")


def test_the_page_has_every_action_and_no_other() -> None:
    page = (REPOSITORY / "docs" / "conformance.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)) - {"do"} == {*ACTIONS, "together", "as_guest"}


def test_a_driver_or_a_manager_must_be_given(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["conformance"]) == 1
    assert main(["conformance", "--case", "nothing", "--", sys.executable]) == 1
    assert "no case nothing" in capsys.readouterr().err
    assert main(["conformance", "--", "no-such-command-at-all"]) == 1
