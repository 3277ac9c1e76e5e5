# SPDX-License-Identifier: Apache-2.0
"""The same input gives the same bytes and the same words: in any process, folder, locale, time zone, order of files."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from build_support import NAMES, copy_examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_build_golden import tree

pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")

ROOT = Path(__file__).parents[3]
COMMAND = [sys.executable, "-c", "import sys; from cm.cli.main import main; sys.exit(main())", "build"]
PLAIN = {"PYTHONHASHSEED": "0", "LC_ALL": "C.UTF-8", "TZ": "UTC"}
# a locale without UTF-8, as a build server may have
BARE = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def run(words: list[str], cwd: Path, umask: int = 0o022, **environment: str) -> str:
    """Return what ``cm build`` prints, without the test's folders; it must succeed."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith(("LC_", "LANG", "PYTHON", "TZ"))}
    done = subprocess.run(
        [*COMMAND, *words],
        cwd=cwd,
        env=kept | PLAIN | environment | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        check=False,
        umask=umask,
    )
    assert done.returncode == 0, done.stderr.decode(errors="replace")
    return done.stdout.decode(errors="replace")


class Trees(dict[str, dict[str, str]]):
    """Checksums of files, by example."""

    def __repr__(self) -> str:
        return "Trees()"


def checksums(folder: Path) -> dict[str, str]:
    return {name: hashlib.sha256(data).hexdigest() for name, data in tree(folder).items()}


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Trees:
    """Each example's tree as one process makes it."""
    folder = copy_examples(tmp_path_factory.mktemp("first"))
    for name in NAMES:
        run(["generate", "build.yaml"], folder / name)
        run(["configure", "--defaults"], folder / name)
    return Trees({name: checksums(folder / name / "build") for name in NAMES})


@given(
    name=st.sampled_from(NAMES),
    seed=st.integers(1, 4_294_967_295),
    locale=st.sampled_from([{}, BARE]),
    zone=st.sampled_from(["UTC", "Asia/Kathmandu"]),
    umask=st.sampled_from([0o022, 0o077]),
    where=st.sampled_from(["beside", "below", "root"]),
)
@settings(max_examples=4, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_another_process_generates_the_same_bytes(
    tmp_path_factory: pytest.TempPathFactory,
    first: Trees,
    name: str,
    seed: int,
    locale: dict[str, str],
    zone: str,
    umask: int,
    where: str,
) -> None:
    folder = copy_examples(tmp_path_factory.mktemp("größer als 1"))
    schema = folder / name / "build.yaml"
    cwd, word = {
        "beside": (schema.parent, "build.yaml"),
        "below": (schema.parent / "hdl", "../build.yaml"),
        "root": (Path("/"), str(schema)),
    }[where]
    environment = locale | {"PYTHONHASHSEED": str(seed), "TZ": zone}
    run(["generate", word], cwd, umask, **environment)
    run(["configure", "--defaults", word], cwd, umask, **environment)
    assert checksums(schema.parent / "build") == first[name]


def test_files_made_in_another_order_give_the_same_schema_and_the_same_words(tmp_path: Path) -> None:
    """What ``*`` matches does not depend on the file system's order of files."""
    said = []
    for number, backwards in enumerate((False, True)):
        folder = tmp_path / str(number) / "same"
        (folder / "hdl").mkdir(parents=True)
        source = copy_examples(tmp_path / f"examples {number}") / "camera/hdl"
        for path in sorted(source.iterdir(), reverse=backwards):
            shutil.copy(path, folder / "hdl")
        run(["init", *sorted(str(path.relative_to(folder)) for path in (folder / "hdl").iterdir())], folder)
        text = (folder / "build.yaml").read_text().replace("      - hdl/camera_edge.v\n", '      - "hdl/camera_e*.v"\n')
        (folder / "build.yaml").write_text(text)
        seed = {"PYTHONHASHSEED": str(number + 7)}
        words = [
            run([action, *more], folder, **seed) for action, *more in (["check"], ["check", "--json"], ["generate"])
        ]
        digest = hashlib.sha256(repr(sorted(checksums(folder / "build").items())).encode()).hexdigest()
        said.append((text, [word.replace(str(folder), "") for word in words], digest))
    assert said[0] == said[1]


@pytest.mark.parametrize("action", [["check"], ["interfaces", "hdl/camera_edge.v"], ["partition"]])
def test_a_terminal_without_utf8_shows_what_it_can(action: list[str], tmp_path: Path) -> None:
    folder = copy_examples(tmp_path) / "camera"
    assert "s_axis" in run(action, folder, **BARE) or action == ["partition"]
