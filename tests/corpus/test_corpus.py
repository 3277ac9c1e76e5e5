# SPDX-License-Identifier: Apache-2.0
"""Other people's bitstreams, where a folder of fetched repositories is given: ``CORPUS=FOLDER``."""

from __future__ import annotations

import os
import random
from collections.abc import Iterator
from pathlib import Path

import pytest
from corpus import GOOD, Sample, Verdict, expected, judge, samples

from cm.formats.bitstream import CrcResult, Expectation, FrameRun, assemble, footprint_of, inspect, open_image, refusals
from cm.formats.bitstream.geometry import decode_far, geometry_of
from cm.formats.bitstream.idcodes import Family
from cm.formats.bitstream.packets import frame_writes

FLIPS = 24  # in each file


@pytest.fixture(scope="module")
def files() -> list[tuple[Sample, Verdict]]:
    folder = os.environ.get("CORPUS")
    if not folder:
        pytest.skip("CORPUS names no folder of fetched repositories")
    known = expected()
    found = [(sample, judge(sample.data)) for sample in samples(Path(folder)) if sample.sha256 in known]
    if not found:
        pytest.skip(f"{folder} has no file of the list")
    return found


def test_every_file_is_judged_as_before(files: list[tuple[Sample, Verdict]]) -> None:
    known = expected()
    wrong = [(sample.path, verdict.said, known[sample.sha256][0]) for sample, verdict in files]
    assert [item for item in wrong if item[1] != item[2]] == []


def test_a_flipped_bit_is_refused_in_every_file_with_a_crc(files: list[tuple[Sample, Verdict]]) -> None:
    taken = []
    for sample, verdict in files:
        if verdict.said != GOOD or verdict.report is None or verdict.report.crc is not CrcResult.OK:
            continue
        if "debug" in sample.path:  # what goes to the DOUT pin is covered by nothing
            continue
        draw = random.Random(sample.sha256)
        damaged = bytearray(sample.data)
        image = open_image(sample.data)
        for _ in range(FLIPS):
            at, bit = draw.randrange(image.offset, image.offset + len(image.stream)), draw.randrange(8)
            damaged[at] ^= 1 << bit
            if judge(bytes(damaged)).said == GOOD:
                taken.append((sample.path, at, bit))
            damaged[at] ^= 1 << bit
    assert taken == []


def test_one_frame_too_many_is_refused_in_every_run_of_every_partial(files: list[tuple[Sample, Verdict]]) -> None:
    """Of a device whose columns are known; the mutation is assembled anew, so that its CRC is right."""
    tried, taken = 0, []
    for sample, verdict in files:
        report = verdict.report
        if verdict.said != GOOD or report is None or not report.partial or report.family is not Family.SERIES7:
            continue
        if geometry_of(report.device) is None:
            continue
        expect = Expectation(footprint=footprint_of(report))
        runs = list(_runs(sample.data))
        assert refusals(inspect(assemble(report.device or "", runs)), expect) == (), sample.path
        for index, run in enumerate(runs):
            longer = [*runs[:index], FrameRun(run.address, run.data + bytes(404)), *runs[index + 1 :]]
            found = refusals(inspect(assemble(report.device or "", longer)), expect)
            tried += 1
            if [item.code for item in found] != ["footprint_outside"]:
                taken.append((sample.path, run.address))
    assert taken == []
    assert tried or not any(verdict.report and verdict.report.partial for _, verdict in files)
    print(f"{tried} runs made one frame longer")


def _runs(data: bytes) -> Iterator[FrameRun]:
    for write in frame_writes(open_image(data)):
        if write.data:
            yield FrameRun(decode_far(write.far, Family.SERIES7), write.data)
