# SPDX-License-Identifier: Apache-2.0
"""Runtime and state folders: they must belong to this user, and no file is opened through another user's link."""

from __future__ import annotations

import grp
import os
import pwd
import stat
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cm.server.private_folders import (
    AlreadyServed,
    BoardLock,
    FolderLock,
    Locks,
    UnsafeFolder,
    is_private_group,
    open_inside,
    own_folder,
    private_folder,
    share,
)
from cm.server.provision import Provisioner

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to give folders to other users")
STRANGER = 47113


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_folder_is_made_for_this_user_and_its_group(tmp_path: Path) -> None:
    own_folder(tmp_path / "over/run")
    assert (mode(tmp_path / "over/run"), mode(tmp_path / "over") & 0o022) == (0o700, 0)
    own_folder(tmp_path / "over/run")  # again is fine


@pytest.mark.parametrize("umask", [0o000, 0o002, 0o007, 0o077])
def test_a_folder_has_its_mode_whatever_the_umask(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        own_folder(tmp_path / "over/kernel", mode=0o755)
        private_folder(tmp_path / "over/state")
    finally:
        os.umask(before)
    assert [mode(tmp_path / name) for name in ("over/kernel", "over/state")] == [0o755, 0o700]


def test_a_folder_of_before_becomes_private(tmp_path: Path) -> None:
    tmp_path.chmod(0o750)
    private_folder(tmp_path)
    assert mode(tmp_path) == 0o700


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


def users(monkeypatch: pytest.MonkeyPatch, *members: str, group: str = "anna", gid: int = 1000, other: int = 7) -> None:
    """Anna's primary group is 1000, and that of ben `other`; the group `gid` has members."""
    everybody = {
        uid: SimpleNamespace(pw_name=name, pw_uid=uid, pw_gid=primary)
        for uid, name, primary in ((1000, "anna", 1000), (1001, "ben", other))
    }
    monkeypatch.setattr(pwd, "getpwuid", everybody.__getitem__)
    monkeypatch.setattr(pwd, "getpwall", lambda: list(everybody.values()))
    groups = {gid: SimpleNamespace(gr_name=group, gr_mem=list(members))}
    monkeypatch.setattr(grp, "getgrgid", groups.__getitem__)


@pytest.mark.parametrize(
    ("said", "private"),
    [
        ({}, True),
        ({"members": ("anna",)}, True),
        ({"group": "users"}, True),  # the number is the user's
        ({"members": ("ben",)}, False),
        ({"other": 1000}, False),  # it is ben's primary group too
        ({"gid": 1002}, False),  # no group has this number
    ],
)
def test_a_private_group_is_one_that_lets_nobody_else_in(
    monkeypatch: pytest.MonkeyPatch, said: dict[str, Any], private: bool
) -> None:
    said = {**said}
    users(monkeypatch, *said.pop("members", ()), **said)
    assert is_private_group(1000, 1000) is private
    assert not is_private_group(1000, 1001)
    assert not is_private_group(1000, 9)  # a number without an account, as in a container


def test_a_shared_primary_group_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    users(monkeypatch, group="users", gid=100)
    everybody = {1000: SimpleNamespace(pw_name="anna", pw_uid=1000, pw_gid=100)}
    monkeypatch.setattr(pwd, "getpwuid", everybody.__getitem__)
    assert not is_private_group(100, 1000)


def test_a_folder_made_with_a_umask_of_002_is_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `su -`, ssh and desktops set it where each user has a group of their own."""
    (tmp_path / "run").mkdir()
    (tmp_path / "run").chmod(0o775)
    monkeypatch.setattr("cm.server.private_folders.is_private_group", lambda *_: True)
    FolderLock(tmp_path / "run").release()


def test_a_folder_that_its_group_may_write_is_refused_unless_it_is_sticky(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cm.server.private_folders.is_private_group", lambda *_: False)
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


@pytest.mark.parametrize("over", ["over", "over/deeper"])
def test_a_folder_below_one_that_everybody_may_write_is_refused(tmp_path: Path, over: str) -> None:
    """Another user moves it away, puts one of their own there, and is the manager."""
    (tmp_path / over / "run").mkdir(parents=True)
    (tmp_path / "over").chmod(0o777)
    with pytest.raises(UnsafeFolder, match=f"{tmp_path}/over can be written by everybody"):
        own_folder(tmp_path / over / "run")
    (tmp_path / "over").chmod(0o1777)  # as /tmp: what is ours there stays ours
    own_folder(tmp_path / over / "run")


@pytest.mark.programs
@needs_root
@pytest.mark.parametrize("what", ["folder", "link"])
def test_a_folder_below_what_another_user_owns_is_refused(tmp_path: Path, what: str) -> None:
    (tmp_path / "ours/run").mkdir(parents=True)
    theirs = tmp_path / "theirs"
    if what == "link":
        theirs.symlink_to("ours")
    else:
        (theirs / "run").mkdir(parents=True)
    os.chown(theirs, STRANGER, STRANGER, follow_symlinks=False)
    with pytest.raises(UnsafeFolder, match=f"{theirs} (belongs to user {STRANGER}|is not a folder, or a link)"):
        own_folder(theirs / "run")


def test_a_link_of_ours_above_a_folder_is_followed_and_what_it_leads_to_is_judged(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "relative").symlink_to("there/../there")
    (tmp_path / "absolute").symlink_to(tmp_path / "relative")
    own_folder(tmp_path / "absolute/run")
    assert (tmp_path / "there/run").is_dir()
    (tmp_path / "there").chmod(0o777)
    with pytest.raises(UnsafeFolder, match=f"{tmp_path}/there can be written by everybody"):
        own_folder(tmp_path / "absolute/run")
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(UnsafeFolder, match="loop is not a folder, or a link to one"):
        own_folder(tmp_path / "loop/run")


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


@pytest.mark.programs
@needs_root
def test_nobody_holds_a_lock_of_ours_who_may_not_open_the_board(tmp_path: Path) -> None:
    """A lock is held by who can open its file, for reading too."""
    tmp_path.chmod(0o755)
    (tmp_path / "sys/firmware").mkdir(parents=True)
    (tmp_path / "sys/firmware/fdt").touch(0o400)
    private_folder(tmp_path / "state")
    own_folder(tmp_path / "run", STRANGER)
    locks = Locks(tmp_path / "run", tmp_path, STRANGER)
    names = ["run/lock", "state", "sys/firmware/fdt"]
    tried = subprocess.run(
        [sys.executable, "-c", _TRY, str(STRANGER), *(str(tmp_path / name) for name in names)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert tried.stdout.split() == ["PermissionError"] * 3
    with pytest.raises(AlreadyServed):
        BoardLock(tmp_path)
    locks.release()


_TRY = """
import os, sys
os.setgroups([]); os.setgid(int(sys.argv[1])); os.setuid(int(sys.argv[1]))
for name in sys.argv[2:]:
    try:
        os.open(name, os.O_RDONLY)
        print("opened")
    except OSError as error:
        print(type(error).__name__)
"""


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

    monkeypatch.setattr(os, "chown", refuse)
    with pytest.raises(UnsafeFolder, match=f"{tmp_path}/run cannot be given to group 77: only root, and members of it"):
        own_folder(tmp_path / "run", 77)
    (tmp_path / "run").chmod(0o750)
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
