# SPDX-License-Identifier: Apache-2.0
"""``import pynq``: where it means cm.pynq, and where it does not."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from manager_process import environment


def ran(*arguments: str | Path, **variables: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment(**variables))


def program(folder: Path, text: str) -> Path:
    path = folder / "program.py"
    path.write_text(text)
    return path


def test_a_program_finds_pynq_its_own_folder_and_its_arguments(tmp_path: Path) -> None:
    (tmp_path / "beside.py").write_text("VALUE = 5\n")
    lines = (
        "import sys, beside, pynq.lib.dma\n"
        "from pynq import Overlay, MMIO\n"
        "from pynq.lib.axigpio import AxiGPIO\n"
        "from pynq.ps import Clocks; from pynq.xlnk import Xlnk; from pynq.pl import PL\n"
        "print(__name__, sys.argv[1:], beside.VALUE, pynq.Overlay is Overlay, pynq.lib.dma.DMA.__module__)\n"
    )
    done = ran("-m", "cm.pynq", program(tmp_path, lines), "--fast", "2")
    assert done.stdout == "__main__ ['--fast', '2'] 5 True cm.pynq.lib.dma\n", done.stderr


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (
            "from pynq.lib import AxiIIC",
            "the kernel's (i2c-xiic): /dev/i2c-N",
        ),
        ("from pynq.overlays.base import BaseOverlay", "pynq.overlays is not here: cm.pynq has overlays, registers"),
        ("import pynq.lib.video", "pynq.lib.video is not here: cm.pynq has overlays, registers"),
        ("from pynq.lib import AudioADAU1761", "pynq.lib.AudioADAU1761 is not here: cm.pynq has overlays"),
        ("from pynq import GPIO", "pynq.GPIO is not here: the processor's own GPIO is the kernel's"),
    ],
)
def test_what_is_not_here_says_so_in_a_sentence(line: str, said: str, tmp_path: Path) -> None:
    done = ran("-m", "cm.pynq", program(tmp_path, f"{line}\n"))
    assert done.returncode == 1
    assert said in done.stderr.splitlines()[-1]


def test_an_installed_pynq_is_not_shadowed(tmp_path: Path) -> None:
    (tmp_path / "there/pynq").mkdir(parents=True)
    (tmp_path / "there/pynq/__init__.py").write_text("print('theirs')\n")
    path = ":".join([str(tmp_path / "there"), environment()["PYTHONPATH"]])
    done = ran("-m", "cm.pynq", program(tmp_path, "import pynq\n"), PYTHONPATH=path)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("PYNQ itself is installed here (")
    beside = ran("-c", "import pynq, cm.pynq as ours; print(ours.MMIO.__module__)", PYTHONPATH=path)
    assert beside.stdout == "theirs\ncm.pynq.mmio\n", beside.stderr


def test_a_folder_that_is_called_pynq_is_no_installed_pynq(tmp_path: Path) -> None:
    (tmp_path / "pynq").mkdir()
    path = ":".join([str(tmp_path), environment()["PYTHONPATH"]])
    done = ran("-m", "cm.pynq", program(tmp_path, "import pynq; print(pynq.MMIO.__module__)\n"), PYTHONPATH=path)
    assert done.stdout == "cm.pynq.mmio\n", done.stderr


def test_a_notebook_loads_it_as_an_extension(tmp_path: Path) -> None:
    lines = "import cm.pynq; cm.pynq.load_ipython_extension(None); import pynq; print(pynq is cm.pynq)"
    done = ran("-c", lines)
    assert done.stdout == "True\n", done.stderr


def test_the_rest_imports_nothing_of_it() -> None:
    lines = (
        "import sys, cm, cm.aio, cm.cli.main, cm.client.board, cm.server.server\n"
        "print([name for name in sys.modules if name.startswith('cm.pynq')])"
    )
    assert ran("-c", lines).stdout == "[]\n"
