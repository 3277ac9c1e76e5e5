# SPDX-License-Identifier: Apache-2.0
"""Runtime and state folders: they must belong to this user, and no file is opened through another user's link."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from cm.server.private_folders import (
    AlreadyServed,
    BoardLock,
    FolderLock,
    Locks,
    UnsafeFolder,
    open_inside,
    own_folder,
    share,
)
from cm.server.provision import Provisioner

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to give folders to other users")
STRANGER = 47113


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_folder_is_made_for_this_user_and_its_group(tmp_path: Path) -> None:
    own_folder(tmp_path / "run")
    assert mode(tmp_path / "run") & 0o027 == 0
    own_folder(tmp_path / "run")  # again is fine


@pytest.mark.programs
@needs_root
def test_a_folder_is_given_to_the_group_that_may_connect(tmp_path: Path) -> None:
    own_folder(tmp_path / "run", group=STRANGER)
    status = (tmp_path / "run").stat()
    assert (status.st_gid, stat.S_IMODE(status.st_mode) & 0o077) == (STRANGER, 0o050)


@pytest.mark.programs
@needs_root
def test_another_users_folder_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    os.chown(folder, STRANGER, STRANGER)
    with pytest.raises(UnsafeFolder, match=f"belongs to user {STRANGER}"):
        FolderLock(folder)
    assert list(folder.iterdir()) == []


def test_a_world_writable_folder_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    folder.chmod(0o777)
    with pytest.raises(UnsafeFolder, match="written by everybody"):
        FolderLock(folder)


def test_a_folder_that_its_group_may_write_is_refused_unless_it_is_sticky(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    folder.chmod(0o770)
    with pytest.raises(UnsafeFolder, match=f"by its group .* chmod g-w {folder}"):
        FolderLock(folder)
    folder.chmod(0o1770)
    FolderLock(folder).release()


def test_a_link_in_the_place_of_a_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UnsafeFolder, match="a link to one"):
        FolderLock(tmp_path / "run")
    with pytest.raises(UnsafeFolder, match="a link to one"):
        Provisioner(tmp_path / "run").store("config: {name: a, modules: {m: {}}, modes: {m: {modules: [m]}}}", ())
    assert list((tmp_path / "elsewhere").iterdir()) == []


@pytest.mark.parametrize("dangles", [False, True], ids=["to a file", "to nothing"])
def test_the_lock_is_not_opened_through_a_link_and_what_it_leads_to_stays(tmp_path: Path, dangles: bool) -> None:
    victim = tmp_path / "victim"
    if not dangles:
        victim.write_text("precious")
    (tmp_path / "run").mkdir(0o700)
    (tmp_path / "run/lock").symlink_to(victim)
    with pytest.raises(UnsafeFolder, match="is a link"):
        FolderLock(tmp_path / "run")
    assert victim.exists() is not dangles
    assert dangles or victim.read_text() == "precious"


def test_what_is_not_a_regular_file_is_not_opened_as_one(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "lock")
    with pytest.raises(UnsafeFolder, match="is not a file"):
        open_inside(tmp_path, "lock", os.O_RDWR | os.O_NONBLOCK)


def test_a_folder_that_is_served_is_refused_with_the_process_that_serves_it(tmp_path: Path) -> None:
    served = FolderLock(tmp_path / "run")
    with pytest.raises(AlreadyServed, match=rf"\(pid {os.getpid()}\) serves {tmp_path}/run already"):
        FolderLock(tmp_path / "run")
    served.release()
    FolderLock(tmp_path / "run").release()


def test_a_board_that_is_held_is_refused_with_the_process_that_holds_it(tmp_path: Path) -> None:
    (tmp_path / "sys").mkdir()
    lock = BoardLock(tmp_path)
    with pytest.raises(AlreadyServed, match=rf"process( \(pid {os.getpid()}\))? holds the board below {tmp_path}"):
        BoardLock(tmp_path)
    lock.release()
    BoardLock(tmp_path).release()


def test_where_nobody_says_who_holds_a_board_it_is_another_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lock = BoardLock(tmp_path)
    own = tmp_path.stat().st_ino
    for said in (
        None,
        "",
        "1: FLOCK\n",
        f"1: POSIX ADVISORY WRITE 7 fe:00:{own} 0 EOF\n",
        "1: FLOCK A W 7 fe:00:1 0\n",
    ):
        monkeypatch.setattr(
            Path, "read_text", lambda *_, said=said: (_ for _ in ()).throw(OSError) if said is None else said
        )
        with pytest.raises(
            AlreadyServed, match=f"^another process holds the board below {tmp_path.parent} already: two"
        ):
            BoardLock(tmp_path)
    monkeypatch.setattr(Path, "read_text", lambda *_: f"1: FLOCK ADVISORY WRITE 7 fe:00:{own} 0 EOF\n")
    with pytest.raises(AlreadyServed) as refused:
        BoardLock(tmp_path)
    assert str(refused.value) == (
        f"another process (pid 7) holds the board below {tmp_path.parent} already: two managers would load over each "
        "other. Stop it, or give each a board of its own (CM_ROOT)"
    )
    lock.release()


def test_a_folder_that_cannot_be_given_to_the_group_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "fchown", refuse)
    with pytest.raises(UnsafeFolder, match=f"{tmp_path}/run cannot be given to group 77: only root, and members of it"):
        own_folder(tmp_path / "run", 77)
    own_folder(tmp_path / "run", (tmp_path / "run").stat().st_gid)  # it has that, and its members may enter


def test_a_root_without_sysfs_is_locked_itself(tmp_path: Path) -> None:
    lock = BoardLock(tmp_path)
    with pytest.raises(AlreadyServed):
        BoardLock(tmp_path)
    lock.release()


_HOLD = "import fcntl, os, sys; fcntl.flock(os.open(sys.argv[1], os.O_RDONLY), 2); print(flush=True); input()"


def test_a_board_that_is_served_is_refused_with_the_process_that_has_it(tmp_path: Path) -> None:
    """Two at a time, so that neither is found for being the only one."""
    (tmp_path / "ours/sys").mkdir(parents=True)
    (tmp_path / "theirs/sys").mkdir(parents=True)
    ours = BoardLock(tmp_path / "ours")
    command = [sys.executable, "-c", _HOLD, str(tmp_path / "theirs/sys")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        other.stdout.readline()
        for board, pid in (("ours", os.getpid()), ("theirs", other.pid)):
            with pytest.raises(AlreadyServed, match=rf"\(pid {pid}\) holds the board below {tmp_path}/{board} already"):
                Locks(tmp_path / "run", tmp_path / board)
        other.communicate(b"\n")
    ours.release()
    Locks(tmp_path / "run", tmp_path / "ours").release()  # and what was refused has left no lock behind


@pytest.mark.programs
@needs_root
def test_a_socket_is_for_its_owner_and_the_group(tmp_path: Path) -> None:
    path = tmp_path / "socket"
    path.touch(0o777)
    share(path, STRANGER)
    assert (path.stat().st_gid, mode(path)) == (STRANGER, 0o660)
