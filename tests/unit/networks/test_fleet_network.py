# SPDX-License-Identifier: Apache-2.0
"""How a fleet is reached, and the errors if it is not."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path
from unittest.mock import MagicMock

import pytest
import zenoh

import cm.fleet
from cm import child
from cm.cli.parser import build_parser
from cm.errors import InvalidRequest
from cm.networks.fleet.zenoh_session import Network, NoNetwork, closed, endpoint, session

CLOSED = "127.0.0.1:9"


@pytest.mark.parametrize(
    ("text", "router"),
    [
        ("lan", "tcp/lan:7447"),
        ("10.0.0.1:1", "tcp/10.0.0.1:1"),
        ("[::1]", "tcp/[::1]:7447"),
        ("tls/lan:1", "tls/lan:1"),
    ],
)
def test_a_router_is_a_host_or_zenohs_own_spelling(text: str, router: str) -> None:
    assert endpoint(text) == router


@pytest.mark.parametrize(
    ("text", "said"),
    [("http/lan:1", "zenoh has tcp, tls"), (":1", "HOST:PORT"), ("lan:", "HOST:PORT"), ("lan:65536", "HOST:PORT")],
)
def test_an_invalid_router_address_is_refused_before_anything_is_tried(text: str, said: str) -> None:
    with pytest.raises(InvalidRequest, match=said):
        endpoint(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [(None, "No such file or directory"), ("{bad", r"is no file of zenoh's settings \(JSON5\): --> 1:1 .* expected")],
)
def test_an_invalid_file_of_settings_is_named_with_its_mistake(tmp_path: Path, text: str | None, said: str) -> None:
    path = tmp_path / "anna.json5"
    if text is not None:
        path.write_text(text)
    with pytest.raises(NoNetwork, match=said) as caught:
        cm.fleet.connect(config=path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("router", "said"),
    [(f"tcp/{CLOSED}", "is it there"), (f"tls/{CLOSED}", "does not take the other's certificate")],
)
def test_a_router_that_does_not_answer_is_named(tmp_path: Path, router: str, said: str) -> None:
    path = tmp_path / "fleet.json5"  # zenoh's default of three seconds is for real networks
    path.write_text(f'{{mode: "client", connect: {{endpoints: ["{router}"], timeout_ms: 50}}}}')
    with pytest.raises(NoNetwork, match=f"no router answers at {router}: .*{said}"):
        session(Network(config=path))


def test_without_a_router_no_board_on_this_network_is_found(tmp_path: Path) -> None:
    path = tmp_path / "fleet.json5"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        where = f"224.0.0.225:{free.getsockname()[1]}"  # not 7446, where someone may answer
    path.write_text(f'{{mode: "client", scouting: {{timeout: 50, multicast: {{enabled: true, address: "{where}"}}}}}}')
    with pytest.raises(NoNetwork, match="nobody answers on this network: name the fleet's router"):
        session(Network(config=path))


@pytest.mark.parametrize(
    "words",
    [
        "fleet mode edge --policy quorum b1 b2",
        "fleet mode --policy quorum edge b1 b2",
        "fleet mode edge b1 b2 --policy quorum",
    ],
)
def test_options_stand_anywhere_between_the_mode_and_the_boards(words: str) -> None:
    args = build_parser("fleet").parse_args(words.split())
    assert (args.target, args.boards, args.policy) == ("edge", ["b1", "b2"], "quorum")


@pytest.mark.parametrize("words", ["fleet mode --policy quorum", "fleet reg read", "fleet mode edge --nix", "fleet",
    "fleet keys K board b --days 0", "fleet keys K router --host", "fleet keys K router --port 65536"])  # fmt: skip
def test_what_is_missing_or_unknown_is_still_wrong_usage(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        build_parser("fleet").parse_args(words.split())
    assert caught.value.code == 2
    assert "error:" in capsys.readouterr().err


def test_registers_and_keys_have_actions_of_their_own_below() -> None:
    args = build_parser("fleet").parse_args(["fleet", "reg", "write", "led=3", "--timeout", "2", "b1"])
    assert (args.name, args.boards, args.timeout) == ("led=3", ["b1"], 2.0)
    args = build_parser("fleet").parse_args(["fleet", "keys", "DIR", "client", "anna", "--role", "operate"])
    assert (args.name, args.role) == ("anna", "operate")


def test_a_command_that_used_zenoh_ends_without_shutting_python_down() -> None:
    """Threads of zenoh that call Python meanwhile end the process by SIGABRT."""
    code = "import atexit, sys; atexit.register(print, 'shut down'); from cm.cli.main import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "fleet", "ls", "--router", CLOSED]
    done = subprocess.run(command, capture_output=True, text=True, env=child.environment(), check=False, timeout=60)
    assert (done.returncode, done.stdout) == (1, "")
    assert "is it there?" in done.stderr


def test_without_a_network_a_session_is_closed_all_the_same() -> None:
    gone = MagicMock()
    gone.close.side_effect = zenoh.ZError("the farewell was not sent")
    closed(gone)
    gone.close.assert_called_once_with()
