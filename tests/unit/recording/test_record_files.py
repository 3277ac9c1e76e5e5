# SPDX-License-Identifier: Apache-2.0
"""Records on disk: what is in them after a kill, a full disk, a flipped bit; read and repaired, and read by others."""

from __future__ import annotations

import errno
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from cm.cli.main import main
from cm.errors import InvalidRequest
from cm.recording import layout
from cm.wire import cm_pb2 as pb
from cm.wire.messages.status import FrameInfo

pytest.importorskip("mcap", reason="needs the extra [record]")
small_mcap = pytest.importorskip("small_mcap")

from mcap.reader import make_reader  # noqa: E402

from cm.recording import pictures  # noqa: E402
from cm.recording.record import Limits, Record  # noqa: E402
from cm.recording.repair import Repaired, repair  # noqa: E402

pytestmark = [pytest.mark.networks, pytest.mark.timeout(120)]
OPENED = layout.Opened("kria", 0, 1_000, 10**9, "1.0", 5, "1.0")
CLOCK, IRQ = layout.CLOCK, layout.IRQ


def irq(number: int) -> bytes:
    return pb.Irq(name="done", count=number, timestamp_ns=number).SerializeToString()


def recorded(place: Path, limits: Limits = Limits(), told: Callable[[str], object] = lambda _: None) -> Record:  # noqa: B008
    state = lambda record: [(record.channel(CLOCK), pb.Clock(monotonic_ns=1).SerializeToString())]  # noqa: E731
    return Record(place, limits, OPENED, time.time_ns, state, told)


def written(path: Path, messages: int = 400, chunk: int = 20) -> bytes:
    """A record of so many interrupts and some pictures; what waits is written after each `chunk`."""
    record = recorded(path)
    source = random.Random(1)
    for number in range(1, messages + 1):
        record.log(record.channel(IRQ), irq(number), number)
        if number % chunk == 0:
            info = FrameInfo("camera", number, number, 3072, (32, 32, 3))
            data = pictures.head_of(info, 3072, number).data, source.randbytes(3072)
            record.log(record.channels.of("cm_stream/camera", pictures.SCHEMA), data, number)
            record.tick()
    record.close()
    return path.read_bytes()


def counts(path: Path) -> list[int]:
    """Numbers of the interrupts, as the strictest reader sees them."""
    with path.open("rb") as file:
        messages = list(make_reader(file, validate_crcs=True).iter_messages(topics=[IRQ]))
    return [pb.Irq.FromString(message.data).count for _, _, message in messages]


def gaps(path: Path) -> list[pb.Gap]:
    with path.open("rb") as file:
        return [pb.Gap.FromString(m.data) for _, _, m in make_reader(file).iter_messages(topics=[layout.GAP])]


def strictly_read(path: Path) -> int:
    """Messages of a file by another implementation, all CRCs checked."""
    with path.open("rb") as file:
        return sum(1 for _ in small_mcap.read_message(file, validate_crc=True))


def repaired(data: bytes, folder: Path) -> tuple[Repaired, Path]:
    source, target = folder / "damaged.mcap", folder / "good.mcap"
    source.write_bytes(data)
    target.unlink(missing_ok=True)
    return repair(source, target), target


def chunks(data: bytes) -> list[tuple[int, int]]:
    """Where the chunks begin and end."""
    found, at = [], 8
    while data[at] != 0x0F:
        end = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        if data[at] == 6:
            found.append((at, end))
        at = end
    return found


def test_a_whole_record_is_repaired_to_the_same_messages(tmp_path: Path) -> None:
    data = written(tmp_path / "whole.mcap")
    found, target = repaired(data, tmp_path)
    assert found.lost == ()
    assert counts(target) == counts(tmp_path / "whole.mcap") == list(range(1, 401))
    assert strictly_read(target) == strictly_read(tmp_path / "whole.mcap") == found.messages


def test_a_record_cut_off_anywhere_gives_every_whole_chunk(tmp_path: Path) -> None:
    """As a kill or a full disk leaves it, at 100 seeded places."""
    data = written(tmp_path / "whole.mcap")
    ends = [end for _, end in chunks(data)]
    begin = next(at for at, _ in chunks(data))
    places = random.Random(58).sample(range(begin, len(data) - 1), 100)
    for place in places:
        found, target = repaired(data[:place], tmp_path)
        whole = sum(end <= place for end in ends)
        assert counts(target) == list(range(1, whole * 20 + 1)), place
        assert strictly_read(target) == found.messages + len(gaps(target))
        if place < data.rindex(b"\x0f\x04" + bytes(7)):  # before the end of the data
            assert found.lost, place
            assert [gap.cause for gap in gaps(target)] == ["damaged"] * len(found.lost)


def test_one_flipped_bit_is_told_and_never_shown_as_data(tmp_path: Path) -> None:
    data = written(tmp_path / "whole.mcap")
    good = set(range(1, 401))
    first, last = chunks(data)[0][0], chunks(data)[-1][1]
    source = random.Random(58)
    inside = [source.randrange(first, last) * 8 + source.randrange(8) for _ in range(150)]
    heads = [
        place * 8 + bit for begin, _ in chunks(data)[3:6] for place in range(begin, begin + 49) for bit in (0, 3, 6)
    ]
    between = [place * 8 + bit for place in range(chunks(data)[4][1], chunks(data)[5][0]) for bit in range(8)]
    for place in (*inside, *heads, *between[:160]):
        damaged = bytearray(data)
        damaged[place // 8] ^= 1 << place % 8
        found, target = repaired(bytes(damaged), tmp_path)
        seen = counts(target)
        assert len(seen) == len(set(seen)), place
        assert set(seen) <= good, place
        if set(seen) != good:
            assert found.lost or found.orphans, place
            assert len(seen) >= 400 - 2 * 20 or place // 8 < chunks(data)[0][1], place
        strictly_read(target)


def test_a_killed_recorder_leaves_all_but_its_last_second(tmp_path: Path) -> None:
    """By SIGKILL, at instants that nobody chose; its own output says what it had written by then."""
    for turn in range(5):
        path = tmp_path / f"killed-{turn}.mcap"
        words = [sys.executable, "-c", KILLED, str(path)]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env={**os.environ}) as process:
            assert process.stdout is not None
            lines = [process.stdout.readline() for _ in range(3 + 7 * turn)]
            process.send_signal(signal.SIGKILL)
            lines += process.stdout.readlines()
        settled = max(int(line) for line in lines if line.endswith("\n"))
        target = tmp_path / f"{turn}.mcap"
        found = repair(path, target)
        assert counts(target)[:settled] == list(range(1, settled + 1))
        assert found.lost


KILLED = f"""
import sys
sys.path[:0] = {[str(Path(__file__).parents[1]), str(Path(__file__).parents[3])]!r}
from recording.test_record_files import *
record = recorded(Path(sys.argv[1]))
for number in range(1, 1_000_000):
    record.log(record.channel(IRQ), irq(number), number)
    if number % 50 == 0:
        record.tick()
        print(number, flush=True)
"""


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, int]]:
    """A disk with `room` bytes, which a test sets; it says so as a disk does: a short write, then ENOSPC."""
    disk = {"room": 1 << 40}
    write, statvfs = os.write, os.statvfs

    def limited(descriptor: int, parts: Any) -> int:
        if not disk["room"]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        taken = write(descriptor, b"".join(parts)[: disk["room"]])
        disk["room"] -= taken
        return taken

    def free(path: Any) -> os.statvfs_result:
        found = list(statvfs(path))
        found[4] = disk["room"] // found[1]
        return os.statvfs_result(found)

    monkeypatch.setattr("cm.recording.file.os.writev", limited)
    monkeypatch.setattr("cm.recording.record.os.statvfs", free)
    return disk


def test_a_full_disk_is_a_gap_with_its_length_in_the_next_file(tmp_path: Path, full_disk: dict[str, int]) -> None:
    path, told = tmp_path / "full.mcap", []
    record = recorded(path, told=told.append)
    for number in range(1, 101):
        record.log(record.channel(IRQ), irq(number), number)
    record.tick()  # these are on disk
    full_disk["room"] = 1000
    for number in range(101, 301):
        record.log(record.channel(IRQ), irq(number), number)
    record.tick()
    for number in range(301, 401):
        record.log(record.channel(IRQ), irq(number), number)
    full_disk["room"] = 1 << 30
    record.tick()
    record.log(record.channel(IRQ), irq(401), 401)
    record.close()
    first, second = layout.files_of(path)
    target = tmp_path / "first.mcap"
    repair(first, target)
    assert counts(target) == list(range(1, 101))
    assert counts(second) == [401]
    (gap,) = gaps(second)
    assert (gap.cause, gap.messages, gap.from_ns) == ("disk_full", 300, 101)
    assert gap.bytes == sum(len(irq(number)) for number in range(101, 401))
    assert "No space left" in told[0]
    assert "300 messages" in told[1]
    assert record.missing == 0


def test_what_no_file_tells_is_counted_at_the_end(tmp_path: Path, full_disk: dict[str, int]) -> None:
    record = recorded(tmp_path / "full.mcap")
    full_disk["room"] = 0
    for number in range(1, 51):
        record.log(record.channel(IRQ), irq(number), number)
    record.close()
    assert record.missing == 50 + 1  # with the state that the file began with


def test_a_ring_keeps_what_it_was_asked_for_and_goes_on_after_a_restart(tmp_path: Path) -> None:
    ring, limits = tmp_path / "ring", Limits(ring_bytes=8 << 20)
    record, total = recorded(ring, limits), 0
    for number in range(1, 41):
        record.log(
            record.channel("cm_stream/x", layout.DATA), pb.FrameData(data=bytes(500_000)).SerializeToString(), number
        )
    record.close()
    kept = layout.files_of(ring)
    total = sum(path.stat().st_size for path in kept)
    assert 5 << 20 < total <= 9 << 20
    assert kept[0].name != "000001.mcap"
    for path in kept:  # each finished file is whole, and begins with the state
        strictly_read(path)
        with path.open("rb") as file:
            topics = [channel.topic for _, channel, _ in make_reader(file).iter_messages(log_time_order=False)]
        assert topics[0] == CLOCK
    again = recorded(ring, limits)
    again.log(again.channel(IRQ), irq(1), 1)
    again.close()
    newest = layout.files_of(ring)[-1]
    assert int(newest.stem) == int(kept[-1].stem) + 1
    assert [gap.cause for gap in gaps(newest)] == ["recorder_ended"]


@pytest.mark.parametrize("by", [86_400, -86_400], ids=["forward", "back"])
def test_a_ring_lasts_though_the_clock_is_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, by: int) -> None:
    clock, passed = time.monotonic, 0
    monkeypatch.setattr(time, "monotonic", lambda: clock() + passed)
    record = recorded(tmp_path / "ring", Limits(split_bytes=1, ring_seconds=60))
    for passed in (0, 0, 61):
        record.log(record.channel(IRQ), irq(1), 1)
        there = [int(path.stem) for path in record.files]
        assert there == ([3, 4] if passed else list(range(1, there[-1] + 1)))
        for path in record.files:  # what was written before has stamps of the clock of then
            os.utime(path, times=(time.time() - by,) * 2)
    record.close()


def test_a_ring_on_a_full_disk_gives_its_oldest_file_for_the_newest(
    tmp_path: Path, full_disk: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    ring = tmp_path / "ring"
    record = recorded(ring, Limits(ring_bytes=64 << 20))
    frame = pb.FrameData(data=bytes(2 << 20)).SerializeToString()
    for number in range(8):
        record.log(record.channel("cm_stream/x", layout.DATA), frame, number)
    oldest = layout.files_of(ring)[0]
    unlink = Path.unlink

    def freed(path: Path, missing_ok: bool = False) -> None:
        full_disk["room"] += path.stat().st_size
        unlink(path, missing_ok)

    monkeypatch.setattr("pathlib.Path.unlink", freed)
    full_disk["room"] = 0
    record.log(record.channel("cm_stream/x", layout.DATA), frame, 8)
    record.log(record.channel("cm_stream/x", layout.DATA), frame, 9)
    record.close()
    assert not oldest.exists()
    (gap,) = gaps(layout.files_of(ring)[-1])
    assert (gap.cause, gap.messages) == ("disk_full", 1 + 1)  # with the state that its file began with


def test_a_record_is_split_and_its_files_follow_each_other(tmp_path: Path) -> None:
    path = tmp_path / "split.mcap"
    record = recorded(path, Limits(split_bytes=1 << 20))
    for number in range(1, 9):
        record.log(
            record.channel("cm_stream/x", layout.DATA), pb.FrameData(data=bytes(400_000)).SerializeToString(), number
        )
        record.log(record.channel(IRQ), irq(number), number)
    record.close()
    files = layout.files_of(path)
    assert files[:2] == [path, tmp_path / "split-000002.mcap"]
    assert [number for file in files for number in counts(file)] == list(range(1, 9))
    for number, file in enumerate(files, 1):
        with file.open("rb") as stream:
            (metadata,) = make_reader(stream).iter_metadata()
        assert layout.opened(metadata.metadata).number == number


def test_no_record_is_written_over(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"something else")
    with pytest.raises(InvalidRequest, match="is there already"):
        recorded(tmp_path / "a.mcap")
    recorded(tmp_path / "folder", Limits(split_seconds=1)).close()
    with pytest.raises(InvalidRequest, match="has a record already"):
        recorded(tmp_path / "folder", Limits(split_seconds=1))
    (tmp_path / "b-000002.mcap").touch()
    with pytest.raises(InvalidRequest, match=r"b-000002\.mcap is there already"):
        recorded(tmp_path / "b.mcap")
    ring = recorded(tmp_path / "ring", Limits(ring_seconds=60))
    with pytest.raises(InvalidRequest, match="another recorder writes into"):
        recorded(tmp_path / "ring", Limits(ring_seconds=60))
    ring.close()
    whole = written(tmp_path / "c.mcap")
    assert main(["record", "plot", str(tmp_path / "c.mcap"), str(tmp_path / "c.mcap")]) == 1
    assert (tmp_path / "c.mcap").read_bytes() == whole


def test_a_next_file_that_cannot_be_made_is_a_gap(tmp_path: Path) -> None:
    told: list[str] = []
    record = recorded(tmp_path / "a.mcap", Limits(split_bytes=1), told.append)
    (tmp_path / "a-000002.mcap").mkdir()
    for number in (1, 2):
        record.log(record.channel(IRQ), irq(number), number)
        record.tick()
    assert f"{tmp_path / 'a-000002.mcap'}: File exists" in told[0]
    record.close()
    assert (counts(tmp_path / "a.mcap"), record.missing) == ([1], 0)
    assert [(gap.cause, gap.messages) for gap in gaps(tmp_path / "a-000003.mcap")] == [("disk_error", 1)]


def test_a_message_that_the_library_refuses_spoils_nothing(tmp_path: Path) -> None:
    record = recorded(tmp_path / "a.mcap")
    record.log(record.channel(IRQ), irq(1), 1)
    for data, at in ((2, 2), (irq(2), -1), (irq(2), 1 << 70)):
        with pytest.raises((TypeError, OverflowError, ValueError)):
            record.log(record.channel(IRQ), data, at)  # type: ignore[arg-type]
    record.log(record.channel(IRQ), irq(3), 3)
    record.close()
    assert counts(tmp_path / "a.mcap") == [1, 3]


def test_the_command_says_what_is_lost(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = written(tmp_path / "whole.mcap")
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    assert main(["record", "repair", str(tmp_path / "cut.mcap"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["file"] == str(tmp_path / "cut-repaired.mcap")
    assert 0 < told["messages"] < 400
    assert len(told["lost"]) == 1
    assert main(["record", "repair", str(tmp_path / "cut.mcap")]) == 1
    assert "is there already" in capsys.readouterr().err


def test_a_disk_that_is_too_full_for_a_repair_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written(tmp_path / "a.mcap")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5000, hard))
    try:
        assert main(["record", "repair", str(tmp_path / "a.mcap"), str(tmp_path / "b.mcap")]) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert f"{tmp_path / 'b.mcap'}: File too large" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap"]


def test_what_to_install_is_said_where_the_library_is_missing(tmp_path: Path) -> None:
    code = "import sys; sys.modules['mcap'] = None; from cm.cli.main import main; sys.exit(main())"
    for words in ("a.mcap", "a --ring 5min"):
        command = [sys.executable, "-c", code, "record", *words.split()]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
        assert (done.returncode, done.stdout) == (1, ""), done.stderr
        assert len(done.stderr.splitlines()) == 1
        assert "pip install" in done.stderr


def test_the_doctor_finds_nothing_wrong(tmp_path: Path) -> None:
    doctor = shutil.which("pymcap-cli", path=str(Path(sys.executable).parent))
    if doctor is None:
        pytest.skip("needs pymcap-cli")
    data = written(tmp_path / "whole.mcap")
    _, target = repaired(data[: len(data) // 2], tmp_path)
    for path in (tmp_path / "whole.mcap", target):
        subprocess.run([doctor, "doctor", str(path)], check=True, capture_output=True)


def test_a_frame_is_copied_by_the_kernel_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its memory is what is written, with all that waits, in one call; so a kill leaves all of a chunk or nothing."""
    calls: list[list[memoryview]] = []
    writev = os.writev
    monkeypatch.setattr("cm.recording.file.os.writev", lambda fd, parts: calls.append(list(parts)) or writev(fd, parts))
    frame = bytearray(1 << 20)
    record = recorded(tmp_path / "a.mcap")
    record.log(record.channel(IRQ), irq(1), 1)
    calls.clear()
    for number in range(2, 5):
        record.log(record.channels.of("cm_stream/x", pictures.SCHEMA), (b"head", memoryview(frame)), number)
        record.log(record.channel(IRQ), irq(number), number)
    assert len(calls) == 3
    for parts in calls:
        assert [part.obj is frame for part in parts].count(True) == 1
        assert sum(len(part) for part in parts if part.obj is not frame) < 20_000
    record.close()
    assert counts(tmp_path / "a.mcap") == [1, 2, 3, 4]


def test_a_full_disk_ends_a_file_behind_its_last_whole_chunk(tmp_path: Path, full_disk: dict[str, int]) -> None:
    """What did not fit wholly is taken away, so strict readers take the file without a repair."""
    path = tmp_path / "full.mcap"
    record = recorded(path)
    record.log(record.channel(IRQ), irq(1), 1)
    record.tick()
    length = path.stat().st_size
    full_disk["room"] = 100
    for number in range(2, 400):
        record.log(record.channel(IRQ), irq(number), number)
    record.tick()
    assert path.stat().st_size == length
    assert repair(path, tmp_path / "good.mcap").lost == (
        "it has no end: its recorder was killed, or its disk was full",
    )
    full_disk["room"] = 1 << 30
    record.close()
    assert counts(layout.files_of(path)[-1]) == []
    (gap,) = gaps(layout.files_of(path)[-1])
    assert (gap.cause, gap.messages) == ("disk_full", 398)


def test_a_picture_is_the_one_that_foxglove_s_own_library_makes() -> None:
    made = pytest.importorskip("foxglove.messages", reason="needs foxglove-sdk")
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    theirs = FileDescriptorSet.FromString(made.RawImage.get_schema().data)
    ours = FileDescriptorSet.FromString(pictures.SCHEMA.data)
    assert pictures.SCHEMA.name == made.RawImage.get_schema().name
    fields = [
        {(f.name, f.number, f.type, f.type_name) for f in s.file[-1].message_type[0].field} for s in (ours, theirs)
    ]
    assert fields[0] == fields[1]
    info = FrameInfo("camera", 3, 7, 3072, (32, 32, 3))
    head = pictures.head_of(info, 3072, 5_000_000_007)
    image = made.RawImage(
        timestamp=made.Timestamp(sec=5, nsec=7), frame_id="camera", width=32, height=32, encoding="rgb8", step=96,
        data=bytes(3072),
    )  # fmt: skip
    kind = picture_class()
    assert kind.FromString(head.data + bytes(3072)) == kind.FromString(image.encode())


def picture_class() -> Any:
    """The class of Foxglove's message, by their description."""
    from google.protobuf import descriptor_pool, message_factory
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    pool = descriptor_pool.DescriptorPool()
    for file in FileDescriptorSet.FromString(pictures.SCHEMA.data).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(pictures.SCHEMA.name))
