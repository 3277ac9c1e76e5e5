# SPDX-License-Identifier: Apache-2.0
"""Who may do what, tried by processes of several users (as root; skipped otherwise)."""

from __future__ import annotations

import contextlib
import json
import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from manager_process import CAMERA, REPOSITORY, Manager, environment, short_folder

from cm.sim import Board as SimBoard

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to be several users")
GROUP, ALICE, BOB, MALLORY = 47110, 47111, 47112, 47113


PLAY = """
import json, os, sys
import cm, cm.aio, cm.client.data_connection, cm.client.stream, cm.client.aio.stream, encodings.idna, numpy.linalg
from cm.errors import CmError

uid, groups, runtime, *acts = json.loads(sys.argv[1])
os.setgroups(groups)  # what was imported may lie in a folder that this user cannot read
os.setgid(uid)
os.setuid(uid)

def tried(act):
    try:
        return str(act())
    except (CmError, OSError) as error:
        return f"{type(error).__name__}: {getattr(error, 'code', '')}: {error}"

def write(name, value):
    board.registers[name] = value

try:
    with cm.connect(runtime_dir=runtime, timeout=10) as board:
        result = {act: tried(eval("lambda: " + act)) for act in acts}
except (CmError, OSError) as error:
    result = {"connect": f"{type(error).__name__}: {getattr(error, 'code', '')}: {error}"}
print(json.dumps(result))
"""


def outcome(manager: Manager, uid: int, *acts: str, groups: tuple[int, ...] = (GROUP,)) -> dict[str, str]:
    """What comes of acts of a user, who is a member of groups; or of connecting."""
    command = [sys.executable, "-c", PLAY, json.dumps([uid, groups, str(manager.runtime), *acts])]
    done = subprocess.run(
        command, env=environment(), capture_output=True, text=True, timeout=60, check=False, cwd=REPOSITORY
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, str] = json.loads(done.stdout)
    return found


@contextlib.contextmanager
def shared(access: str) -> Iterator[Manager]:
    """A manager whose sockets belong to a group, with these lines under `access`."""
    with short_folder() as folder, SimBoard([CAMERA], root=folder / "board") as sim:
        folder.chmod(0o755)
        settings = folder / "cm.yaml"
        settings.write_text(f"state_dir: {folder}/state\naccess:\n  group: '{GROUP}'\n{access}")
        arguments = ("--settings", str(settings), "--config", str(CAMERA), "--root", str(sim.root))
        manager = Manager(folder / "run", *arguments, service=True)
        manager.start()
        with manager.connected() as board:
            board.load("camera", "default")
        try:
            yield manager
        finally:
            manager.stop()


@needs_root
def test_the_sockets_are_for_the_group_and_nobody_else() -> None:
    with shared("") as manager:
        for name in ("pub", "sub", "req", "data"):
            status = (manager.runtime / name).stat()
            assert (status.st_gid, stat.S_IMODE(status.st_mode)) == (GROUP, 0o660), name
        assert stat.S_IMODE(manager.runtime.stat().st_mode) == 0o750


@needs_root
def test_two_users_of_different_roles_and_one_without() -> None:
    with shared(f"  local: []\n  users: {{'{ALICE}': operate, '{BOB}': observe}}\n") as manager:
        acts = ("board.status.mode", "board.registers['focus']", "write('focus', 2)")
        assert outcome(manager, ALICE, *acts) == {acts[0]: "default", acts[1]: "1", acts[2]: "None"}
        seen = outcome(manager, BOB, *acts)
        assert (seen[acts[0]], seen[acts[1]]) == ("default", "2")
        assert seen[acts[2]].startswith("RequestForbidden: forbidden: ")
        assert "takes the role operate" in seen[acts[2]]


def test_one_user_needs_no_setting_at_all(tmp_path: Path) -> None:
    with short_folder() as folder, SimBoard([CAMERA], root=folder / "board") as sim:
        arguments = ("--config", str(CAMERA), "--root", str(sim.root), "--state-dir", str(tmp_path / "state"))
        manager = Manager(folder / "run", *arguments).start()
        try:
            with manager.connected() as board:
                board.load("camera", "edge_detection")
                board.registers["focus"] = 3
                assert board.registers["focus"] == 3
        finally:
            manager.stop()


@needs_root
def test_who_is_not_of_the_group_is_told_so_at_once() -> None:
    with shared("") as manager:
        told = outcome(manager, MALLORY, "board.status", groups=())["connect"]
    assert told.startswith("NotAdmitted: forbidden: this user may not use the sockets in ")
    assert f"members of {GROUP}" in told or "members of its group" in told


@needs_root
def test_who_is_of_the_group_but_has_no_role_is_told_so_at_once() -> None:
    with shared("  local: []\n") as manager:
        told = outcome(manager, MALLORY, "board.status")["connect"]
    assert told.startswith("NotAdmitted: forbidden: the manager at ipc://")
    assert "gives this user no role" in told
