# SPDX-License-Identifier: Apache-2.0
"""Bitstreams of other people's repositories: what we say of each, beside what we said before.

    python tests/corpus/corpus.py FOLDER            # one folder below for each repository (owner+name)
    python tests/corpus/corpus.py FOLDER --update   # write the list of verdicts again

The files themselves are nobody's to pass on: the list holds their sha256, what is expected, and where
they were found.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import sys
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cm.formats.bitstream import BitstreamError, Report, inspect

LIST = Path(__file__).with_name("verdicts.tsv")
PLAIN = {".bit", ".bin", ".pdi"}
PACKED = {".hdf", ".xsa"}  # zip archives with a .bit in them
GOOD = "good"


@dataclass(frozen=True, slots=True)
class Sample:
    """A file: where it was found, and its bytes."""

    repository: str
    path: str
    data: bytes

    @property
    def sha256(self) -> str:
        """Of the bytes, unpacked where they were packed."""
        return hashlib.sha256(self.data).hexdigest()


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is said of a file: `good`, or the codes of all refusals."""

    said: str
    device: str
    kind: str
    report: Report | None


def samples(corpus: Path) -> Iterator[Sample]:
    """Give every file that may be a bitstream, each content once, in the order of repositories and paths."""
    seen: set[str] = set()
    for folder in sorted(path for path in corpus.iterdir() if path.is_dir()):
        for path in sorted(path for path in folder.rglob("*") if path.is_file() and ".git" not in path.parts):
            for name, data in _contents(path):
                sample = Sample(folder.name.replace("+", "/", 1), str(path.relative_to(folder)) + name, data)
                if sample.sha256 not in seen:
                    seen.add(sample.sha256)
                    yield sample


def _contents(path: Path) -> Iterator[tuple[str, bytes]]:
    if path.suffix.lower() in PLAIN:
        yield "", path.read_bytes()
    elif path.name.lower().endswith(".bit.gz"):
        try:
            yield "", gzip.decompress(path.read_bytes())
        except (OSError, EOFError, zlib.error):
            return
    elif path.suffix.lower() in PACKED and zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            for name in sorted(archive.namelist()):
                if name.lower().endswith((".bit", ".bin")):
                    yield f"!{name}", archive.read(name)


def judge(data: bytes) -> Verdict:
    """Inspect without knowing what it is meant for."""
    try:
        report = inspect(data)
    except BitstreamError as error:
        return Verdict(error.code, "-", "-", None)
    codes = sorted({problem.code for problem in report.problems})
    kind = ("partial" if report.partial else "full") + (", compressed" if report.compressed else "")
    return Verdict(",".join(codes) or GOOD, report.device or "-", kind, report)


def listed(sample: Sample, verdict: Verdict) -> bool:
    """Whether a file belongs on the list: many a .bin is something else altogether."""
    return verdict.said != "no_sync" or ".bit" in sample.path.lower()


def expected() -> dict[str, tuple[str, str]]:
    """Return the list: verdict and place by sha256."""
    lines = LIST.read_text(encoding="utf-8").splitlines()
    rows = (line.split("\t") for line in lines if line and not line.startswith("#"))
    return {sha256: (said, place) for sha256, said, place in rows}


def update(corpus: Path) -> None:
    """Write the list from what is said now."""
    lines = ["# SPDX-License-Identifier: Apache-2.0", "# sha256, verdict, owner/repository:path; made by corpus.py"]
    for sample in samples(corpus):
        verdict = judge(sample.data)
        if listed(sample, verdict):
            lines.append(f"{sample.sha256}\t{verdict.said}\t{sample.repository}:{sample.path}")
    LIST.write_text("\n".join(lines) + "\n", encoding="utf-8")


def report(corpus: Path) -> int:
    """Print each file with what is said of it; 1 if that is not what the list expects."""
    known, wrong = expected(), 0
    for sample in samples(corpus):
        verdict = judge(sample.data)
        before = known.get(sample.sha256, ("new", ""))[0]
        if not listed(sample, verdict) and before == "new":
            continue
        note = "" if before == verdict.said else f"   <- expected {before}" if before != "new" else "   (new)"
        wrong += bool(note) and before != "new"
        print(f"{verdict.said:24} {verdict.device:9} {verdict.kind:20} {sample.repository}:{sample.path}{note}")
    return 1 if wrong else 0


def main() -> int:
    """Command line."""
    assert __doc__ is not None
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("corpus", type=Path, metavar="FOLDER")
    parser.add_argument("--update", action="store_true", help="write the list of verdicts again")
    args = parser.parse_args()
    if args.update:
        update(args.corpus)
        return 0
    return report(args.corpus)


if __name__ == "__main__":
    sys.exit(main())
