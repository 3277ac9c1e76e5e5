# SPDX-License-Identifier: Apache-2.0
"""The simulator as a process: start, end, crash, neighbours, clients that die or do not read."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import resource
import select
import signal
import socket
import stat
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sim_support import Dma, Icap, Node, Uio

from cm.formats.bitstream.container import to_dma_words
from cm.simulation.software import Board, Control, SimError
from cm.simulation.software.process.main import main
from cm.simulation.software.transport import protocol as p

REPOSITORY = Path(__file__).resolve().parents[3]
FAST = ["--hold", "0", "--rate", "0"]
PATIENT = [*FAST, "--linger", "60"]  # survives without an owner for as long as a busy machine may take to start another


def until(condition: Callable[[], bool], timeout: float = 60.0) -> bool:
    """Whether a condition that nothing announces comes true in time."""
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            return False
        select.select([], [], [], 0.02)
    return True


def test_a_board_that_is_stopped_removes_all_it_made(tmp_path):
    root = tmp_path / "root"
    (root / "lib/firmware").mkdir(parents=True)
    (root / "lib/firmware/mine.bin").write_bytes(b"mine")
    board = Board(root=root, arguments=FAST).start()
    assert (root / "dev/uio0").is_socket()
    assert board.stop() == 0
    assert [path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()] == [
        "lib/firmware/mine.bin"
    ]


def test_a_forked_child_that_leaves_a_boards_block_leaves_the_board_to_its_parent():
    with Board(arguments=FAST) as board:
        child = os.fork()
        if not child:
            board.close()  # as sys.exit() and an error in a `with` block do
            os._exit(0)
        assert os.waitpid(child, 0)[1] == 0
        assert board.alive
        assert board.control.state()["pid"] == board.pid
    assert not board.root.exists()


def test_a_single_schema_needs_no_list(tmp_path):
    schema = tmp_path / "one.yaml"
    schema.write_text("config: {name: one, modules: {default: {}}, modes: {m: {modules: [default]}}}\n")
    with Board(str(schema), arguments=FAST) as board:
        assert list(board.control.state()["regions"]) == ["prr0"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_with_status_zero_and_removes_a_root_of_its_own(tmp_path, number):
    root = tmp_path / "root"
    board = Board(root=root, arguments=FAST).start()
    os.kill(board.pid, number)
    assert until(lambda: not board.alive)
    assert board.stop() == 0
    assert not root.exists()


def test_a_board_starts_where_another_was_killed(tmp_path):
    board = Board(root=tmp_path / "root", arguments=FAST).start()
    with Node(board.root, "sys/kernel/config/device-tree/overlays/.node") as folder:
        for op, name in ((p.OP_MKDIR, b"gone"), (p.OP_RMDIR, b"gone"), (p.OP_MKDIR, b"left"), (p.OP_MKDIR, b"gone")):
            folder.call(op, name)
        folder.call(p.OP_RMDIR, b"gone")
    first = (board.root / "proc/sys/kernel/random/boot_id").read_text()
    board.kill()
    assert (board.root / "dev/uio0").exists()
    board.restart()
    assert (board.root / "proc/sys/kernel/random/boot_id").read_text() != first
    assert not (board.root / "sys/kernel/config/device-tree/overlays/left").exists()
    with Uio(board.root, "dev/uio0") as uio:
        assert uio.read(0x14) == 0
    board.stop()
    assert not board.root.exists()


def start_alone() -> tuple[subprocess.Popen[bytes], Path]:
    """A simulator with a root of its own, and that root."""
    command = [sys.executable, "-m", "cm.simulation.software", "--linger", "5"]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, env=environment)
    return process, Path(json.loads(process.stdout.readline())["root"])


def test_what_a_killed_board_left_in_a_root_of_its_own_is_removed_by_the_next():
    first, left = start_alone()
    first.kill()
    first.communicate()
    assert left.exists()
    second, root = start_alone()
    assert not left.exists()
    (root / "lib/firmware/converted.bin").write_bytes(b"by a client")
    second.terminate()
    second.communicate()
    assert second.returncode == 0
    assert not root.exists()


def test_a_second_board_on_one_root_is_refused_with_the_first_ones_process(tmp_path):
    with Board(root=tmp_path, arguments=FAST) as board:
        with pytest.raises(SimError, match=f"another simulator \\(process {board.pid}\\)"):
            Board(root=tmp_path, arguments=FAST).start()
        assert board.control.state()["pid"] == board.pid


def test_the_length_of_the_root_does_not_matter(tmp_path):
    root = tmp_path / ("a" * 100) / ("b" * 100)
    with Board(root=root, arguments=FAST) as board, Uio(board.root, "dev/uio0") as uio:
        uio.write(0x14, 1)
        assert uio.read(0x14) == 1


def test_a_board_that_cannot_start_says_why(tmp_path):
    (tmp_path / "bad.yaml").write_text("config:\n  name: x\n  device: zx81\n  modes: {}\n")
    with pytest.raises(SimError, match=r"bad\.yaml:\d+:\d+: "):
        Board([tmp_path / "bad.yaml"]).start()


def test_control_of_a_root_without_a_simulator_says_so(tmp_path):
    with pytest.raises(
        SimError, match=f"no simulator serves .*: No such file or directory; start one with cm sim --root {tmp_path}"
    ):
        Control(tmp_path).state()


# --- clients


def connect(root: Path, relative: str) -> socket.socket:
    """A client that waits to be served."""
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    fd = os.open(root / relative, os.O_PATH)
    sock.connect(f"/proc/self/fd/{fd}")
    os.close(fd)
    return sock


def opening(sock: socket.socket, patience: float = 0.3) -> int | None:
    """The errno of its open, or None without an answer."""
    if not select.select([sock], [], [], patience)[0]:
        return None
    data, fds, _, _ = socket.recv_fds(sock, 100, 1)
    for fd in fds:
        os.close(fd)
    return p.REPLY.unpack(data)[1]


def fill(sock: socket.socket, packet: bytes) -> int:
    """Send until nothing more is accepted; return how many were sent."""
    sent = 0
    with contextlib.suppress(BlockingIOError):
        while True:
            sock.send(packet)
            sent += 1
    return sent


CLIENT = """
import sys, os
sys.path[:0] = [{repository!r}, {here!r}]
from sim_support import Dma
channel = Dma({root!r}, "dev/cm_dma/from_pl")
handle, memory = channel.alloc(1 << 20)
channel.submit(handle, 1 << 20)
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture(scope="module")
def board():
    with Board(arguments=FAST) as started:
        yield started


def test_a_client_that_is_killed_gives_back_its_channel_and_buffers(board):
    script = CLIENT.format(repository=str(REPOSITORY), here=str(Path(__file__).parents[1]), root=str(board.root))
    client = subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert client.stdout.readline() == b"held\n"
    assert board.control.state()["memory"] == 1 << 20
    client.kill()
    client.communicate()
    with Dma(board.root, "dev/cm_dma/from_pl"):
        state = board.control.state()
        assert state["memory"] == 0
        assert state["channels"]["from_pl"]["queued"] == 0


def test_a_client_that_reads_no_replies_stalls_no_others(board):
    with Node(board.root, "dev/uio0") as deaf, Uio(board.root, "dev/uio0") as uio:
        deaf.sock.setblocking(False)
        request = p.REQUEST.pack(p.OP_REG_READ, p.REG.size) + p.REG.pack(0, 32, 0x14, 0)
        sent = fill(deaf.sock, request)
        uio.write(0x14, 77)
        assert uio.read(0x14) == 77
        deaf.sock.settimeout(60)
        for _ in range(sent):
            assert deaf._reply()[0]


def test_a_client_that_reads_no_interrupts_stalls_no_others(board):
    with Uio(board.root, "dev/uio0") as deaf, Uio(board.root, "dev/uio0") as uio:
        deaf.events.setblocking(False)
        for _ in range(50):
            assert fill(deaf.events, b"\1\0\0\0") >= 0
            uio.write(0x14, 5)
            assert uio.read(0x14) == 5


def test_a_board_out_of_descriptors_serves_new_clients_when_others_have_gone(tmp_path):
    with Board(arguments=FAST) as board:
        used = len(list(Path(f"/proc/{board.pid}/fd").iterdir()))
        resource.prlimit(board.pid, resource.RLIMIT_NOFILE, (used + 10, used + 10))
        clients = [connect(board.root, "dev/uio0") for _ in range(20)]
        assert opening(clients[0], 60.0) == 0
        opened = [opening(client) for client in clients[1:]]
        assert set(opened) - {0}
        assert set(opened) <= {0, errno.EMFILE, None}
        for client in clients:
            client.close()
        with Uio(board.root, "dev/uio0") as uio:
            assert uio.read(0x14) == 0


def test_other_nodes_answer_while_a_bitstream_is_loaded(tmp_path):
    with Board(
        arguments=[*FAST, "--icap-rate", "10000"]
    ) as board:  # half a minute, whose end the test does not wait for
        data = to_dma_words(board.root / "lib/firmware/cm/camera/edge.bit")
        with Icap(board.root, "dev/cm_icap0") as icap, Uio(board.root, "dev/uio0") as uio:
            icap.start(data)
            seen = set()
            while len(seen) < 5:
                uio.write(0x14, 3)
                assert uio.read(0x14) == 3
                state, _, done, total, _ = icap.status()
                assert icap.quiet(0)
                assert state == p.STATE_LOADING
                seen.add(done)
            assert max(seen) <= total


def test_a_region_gives_garbage_while_it_is_loaded_and_a_second_load_is_busy(tmp_path):
    with Board(arguments=FAST) as board:
        board.control.inject("icap_stall", value=100_000)
        folder = board.root / "lib/firmware/cm/camera"
        with Icap(board.root, "dev/cm_icap0") as icap, Dma(board.root, "dev/cm_dma/camera") as channel:
            icap.start(to_dma_words(folder / "edge.bit"))
            assert until(lambda: board.control.state()["regions"]["prr0"]["loading"])
            with pytest.raises(OSError) as caught:
                icap.start(to_dma_words(folder / "edge.bit"))
            assert caught.value.errno == errno.EBUSY
            handle, memory = channel.alloc(480 * 640)
            channel.submit(handle, 480 * 640)
            channel.done()
            assert np.bincount(memory[: 480 * 640], minlength=256).min() > 1000
            assert icap.quiet(0)
            board.control.clear("icap_stall")
            assert icap.finished() == (0, 0)


def test_a_port_that_is_closed_while_it_loads_finishes_the_load(tmp_path):
    with Board(arguments=[*FAST, "--icap-rate", "2000000"]) as board:
        with Icap(board.root, "dev/cm_icap0") as icap:
            icap.start(to_dma_words(board.root / "lib/firmware/cm/camera/edge.bit"))
        assert until(lambda: board.control.state()["regions"]["prr0"]["module"] == "edge")
        assert until(lambda: board.control.state()["buffers"] == 0)


def test_a_camera_keeps_its_rate(tmp_path):
    with (
        Board(arguments=["--hold", "0", "--rate", "100"]) as board,
        Dma(board.root, "dev/cm_dma/camera") as channel,
    ):
        handle, _ = channel.alloc(480 * 640)
        begun = time.monotonic_ns()
        for _ in range(21):
            channel.submit(handle, 480 * 640)
        times = [channel.done()[2] for _ in range(21)]
        assert times[-1] - begun >= 0.2e9  # twenty of 10 ms; late ones make it longer, never shorter


ALL_NODES = [
    "dev/uio0", "dev/cm_dma/camera", "dev/cm_dma/to_pl", "dev/cm_icap0", "sim/control",
    "sys/class/fpga_manager/fpga0/flags", "sys/class/fpga_manager/fpga0/firmware",
    "sys/kernel/config/device-tree/overlays/.node",
]  # fmt: skip
OPS = [*range(8), *(getattr(p, name) for name in dir(p) if "_IOC_" in name), 0xFFFFFFFF]
numbers = st.sampled_from([0, 1, 2, 3, 4, 8, 32, 48, 64, 0x1000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF])
payloads = st.one_of(
    st.binary(max_size=100),
    st.lists(numbers, max_size=16).map(lambda words: struct.pack(f"<{len(words)}I", *words)),
    st.lists(numbers, max_size=12).map(lambda words: struct.pack(f"<{len(words) + 1}I", 4 * len(words) + 4, *words)),
)


@pytest.fixture(scope="module")
def small():
    with Board(arguments=[*FAST, "--memory", "1"]) as started:
        yield started


def error_of(node: Node, op: int, payload: bytes) -> int | None:
    """The errno of a refused request; an exception in the board would give EIO."""
    try:
        _, fds = node.call(op, payload)
    except OSError as error:
        return error.errno or errno.ECONNRESET
    for fd in fds:
        os.close(fd)
    return None


@given(st.sampled_from(ALL_NODES), st.lists(st.tuples(st.sampled_from(OPS), payloads), min_size=1, max_size=20))
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_whatever_is_asked_every_request_has_a_reply_and_the_board_lives(small, relative, requests):
    with Node(small.root, relative) as node:
        for op, payload in requests:
            assert error_of(node, op, payload) not in (errno.EIO, errno.ECONNRESET, errno.EPIPE, errno.ETIMEDOUT)
    assert small.alive
    assert small.control.state()["memory"] == 0


def test_an_idle_board_uses_no_processor_time(board):
    def wakes() -> int:
        """How often its threads went to sleep, which other processes do not affect."""
        tasks = Path(f"/proc/{board.pid}/task").iterdir()
        lines = [line for task in tasks for line in (task / "status").read_text().splitlines()]
        return sum(int(line.split()[1]) for line in lines if line.startswith("voluntary_ctxt_switches"))

    def used() -> float:
        fields = Path(f"/proc/{board.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    time_before, before, begun = used(), wakes(), time.monotonic()
    select.select([], [], [], 1.0)
    passed = time.monotonic() - begun
    assert wakes() - before < 20 * passed  # it looks after its parent four times a second
    assert used() - time_before < 0.25 * passed  # and does not spin


def test_a_board_ends_when_its_parent_has_died_and_it_is_unused(tmp_path):
    root = tmp_path / "root"
    script = (
        "import subprocess, sys, os\n"
        "words = [sys.executable, '-m', 'cm.simulation.software']\n"
        f"board = subprocess.Popen([*words, '--root', {str(root)!r}, '--linger', '0.5'],"
        " stdout=subprocess.PIPE)\n"
        "board.stdout.readline()\n"
        "print(board.pid, flush=True)\n"
        "sys.stdin.read()\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    parent = subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
    )
    parent.stdout.readline()
    with Uio(root, "dev/uio0") as uio:
        parent.kill()
        parent.communicate()
        assert uio.quiet(1.5)
        uio.write(0x14, 1)
        assert uio.read(0x14) == 1
    assert until(lambda: not root.exists())


STARTER = """
import sys
sys.path.insert(0, {repository!r})
from cm.simulation.software import Board
Board(root={root!r}, arguments={arguments!r}).start()
print("started", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def orphaned(tmp_path):
    """A root whose board has lost its owner; the module `edge` runs on it."""
    root = tmp_path / "root"
    script = STARTER.format(repository=str(REPOSITORY), root=str(root), arguments=PATIENT)
    owner = subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert owner.stdout.readline() == b"started\n"
    with pytest.raises(SimError, match="owns this simulator"):
        Control(root).adopt()
    with Icap(root, "dev/cm_icap0") as icap:
        assert icap.load(to_dma_words(root / "lib/firmware/cm/camera/edge.bit")) == (0, 0)
    owner.kill()
    owner.communicate()
    return root


def test_a_board_whose_owner_was_killed_is_taken_over_with_what_it_holds(orphaned):
    pid = Control(orphaned).state()["pid"]
    with Board(root=orphaned, arguments=PATIENT) as board:
        assert board.pid == pid
        assert board.alive
        assert board.control.state()["regions"]["prr0"]["module"] == "edge"
    assert not orphaned.exists()


def test_an_orphaned_board_with_other_arguments_is_replaced(orphaned):
    pid = Control(orphaned).state()["pid"]
    with Board(root=orphaned, arguments=["--hold", "7"]) as board:
        assert board.pid != pid
        assert board.control.state()["regions"]["prr0"]["module"] is None


def test_the_nodes_of_a_board_are_its_users_alone_under_a_umask_that_leaves_the_group_in(tmp_path):
    before = os.umask(0o007)  # as cm.service has
    try:
        with Board(root=tmp_path / "board", arguments=FAST) as board:
            made = [path for path in Path(board.root).rglob("*") if not path.is_symlink()]
            modes = {path: stat.S_IMODE(path.stat().st_mode) for path in made}
            sockets = [path for path in made if path.is_socket()]
            assert len(sockets) > 3
            assert [path for path in sockets if modes[path] & 0o077] == []
            assert [path for path in made if modes[path] & 0o022] == []
    finally:
        os.umask(before)


def test_schemas_that_may_not_be_read_are_told_in_one_line(tmp_path, monkeypatch, capsys):
    def denied(folder):
        raise PermissionError(errno.EACCES, "Permission denied", str(folder))

    monkeypatch.setattr(Path, "iterdir", denied)  # root may read all
    assert main(["--root", str(tmp_path / "root"), "--config", str(tmp_path)]) == 1
    assert capsys.readouterr().err == f"cm sim: {tmp_path}: Permission denied\n"
