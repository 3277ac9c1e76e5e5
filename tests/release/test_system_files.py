# SPDX-License-Identifier: Apache-2.0
"""What the packages install beside the program: unit, rules, modules, users."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from configparser import ConfigParser
from pathlib import Path

import pytest

from cm.cli.parser import build_parser

ROOT = Path(__file__).resolve().parents[2]
SYSTEM = ROOT / "system"
UNIT = SYSTEM / "systemd/cm.service"
BRIDGE = SYSTEM / "systemd/cm-bridge@.service"
BRIDGES = ("fleet", "ros")
LIMIT = 2.5  # exposure, of 10


def lines(path: Path) -> list[str]:
    return [line for line in path.read_text().splitlines() if line and not line.startswith("#")]


def unit(section: str, key: str) -> list[str]:
    """The values of a key that may come several times."""
    part = UNIT.read_text().split(f"[{section}]")[1].split("\n[")[0]
    return re.findall(rf"^{key}=(.*)$", part, re.MULTILINE)


def run(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


needs_systemd = pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="needs systemd-analyze")


@needs_systemd
@pytest.mark.parametrize("unit_file", [UNIT, BRIDGE], ids=lambda path: path.name)
def test_the_service_is_little_exposed(unit_file: Path) -> None:
    text = run("systemd-analyze", "security", "--offline=true", f"--threshold={LIMIT * 10:.0f}", str(unit_file))
    found = re.search(r"Overall exposure level for \S+\.service: ([\d.]+)", text)
    assert found is not None
    assert float(found[1]) <= LIMIT


@needs_systemd
@pytest.mark.parametrize("name", ["cm.service", "cm-bridge@.service", "cm-bridge-reload.path", "cm-record.service"])
def test_the_unit_has_no_line_that_systemd_does_not_know(name: str, tmp_path: Path) -> None:
    for path in (SYSTEM / "systemd").iterdir():
        (tmp_path / path.name).write_text(path.read_text().replace("/usr/bin/cm ", "/bin/true "))
    shown = name.replace("@.", "@fleet.")
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(tmp_path / shown)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "SYSTEMD_UNIT_PATH": f"{tmp_path}:"},
    )
    assert name not in done.stderr
    assert shown not in done.stderr


def test_each_bridge_of_the_unit_has_its_file_of_settings_with_arguments_that_cm_takes() -> None:
    assert "EnvironmentFile=/etc/cm/bridge-%i.conf" in BRIDGE.read_text()
    for name in BRIDGES:
        text = (SYSTEM / f"bridge-{name}.conf").read_text()
        found = re.findall(r"^#?ARGUMENTS=(.*)$", text, re.MULTILINE)
        assert found
        for arguments in found:
            assert build_parser("bridge").parse_args(["bridge", name, *arguments.split()]).run


def test_the_bridges_user_is_no_other_services() -> None:
    """Who speaks to a network is not the manager's user, who may do everything."""
    user = re.search(r"^User=(.*)$", BRIDGE.read_text(), re.MULTILINE)
    assert user is not None
    assert f"u {user[1]} " in (SYSTEM / "sysusers.d/cm.conf").read_text()
    assert f"m {user[1]} fpga" in (SYSTEM / "sysusers.d/cm.conf").read_text()
    assert user[1] not in unit("Service", "User")


@pytest.mark.skipif(not shutil.which("systemd-sysusers"), reason="needs systemd-sysusers")
def test_users_and_groups_are_those_of_the_unit(tmp_path: Path) -> None:
    (tmp_path / "etc").mkdir()
    run("systemd-sysusers", f"--root={tmp_path}", str(SYSTEM / "sysusers.d/cm.conf"))
    users = (tmp_path / "etc/passwd").read_text()
    groups = (tmp_path / "etc/group").read_text()
    assert f"\n{unit('Service', 'User')[0]}:" in f"\n{users}"
    assert re.search(rf"^{unit('Service', 'Group')[0]}:.*:cm,cm-bridge$", groups, re.MULTILINE)


def test_every_kind_of_node_that_udev_gives_to_the_group_is_one_that_the_unit_may_open() -> None:
    kinds = set(re.findall(r'SUBSYSTEM=="(\w+)"', (SYSTEM / "udev/60-cm.rules").read_text()))
    kinds = {"gpiochip" if kind == "gpio" else kind for kind in kinds}  # gpiolib's devices have that name
    assert kinds == {value.split()[0].removeprefix("char-") for value in unit("Service", "DeviceAllow")}


def test_udev_rules_name_the_group_of_the_unit_and_nodes_of_our_drivers() -> None:
    text = (SYSTEM / "udev/60-cm.rules").read_text()
    assert set(re.findall(r'GROUP="(\w+)"', text)) == {unit("Service", "Group")[0]}
    sources = "".join(path.read_text() for path in (ROOT / "kmod").rglob("*.c"))
    for name in ("cm_dma", "axidma", "cm_window"):
        assert f'"{name}"' in sources
        assert f'"{name}"' in text
    (uio,) = [line for line in lines(SYSTEM / "udev/60-cm.rules") if '"uio"' in line]
    assert 'DRIVERS=="cm_*|uio_pdrv_genirq"' in uio  # those of PCI cards reach all memory


def test_only_the_manager_lends_pages() -> None:
    (rule,) = [line for line in lines(SYSTEM / "udev/60-cm.rules") if '"cm_window"' in line]
    assert f'OWNER="{unit("Service", "User")[0]}"' in rule
    assert 'MODE="0600"' in rule
    assert "GROUP" not in rule


def test_modules_that_the_service_asks_for_are_ours_or_the_kernels() -> None:
    built = set(re.findall(r"^CM_MODULES \?= (.*)$", (ROOT / "kmod/Kbuild").read_text(), re.MULTILINE)[0].split())
    loaded = set(re.findall(r"modprobe@(\w+)", " ".join(unit("Unit", "Wants"))))
    assert loaded == set(re.findall(r"modprobe@(\w+)", " ".join(unit("Unit", "After"))))
    modprobe = re.search(r"modprobe -aq (.*) \|\|", (SYSTEM / "sysv/cm").read_text())
    assert modprobe is not None
    assert set(modprobe[1].split()) == loaded
    assert loaded - built == {"uio_pdrv_genirq"}
    assert not loaded & {"cm_plsim", "cm_kunit"}


def test_the_uio_driver_takes_the_nodes_that_cm_build_writes() -> None:
    said = [line.split() for line in lines(SYSTEM / "modprobe.d/cm.conf")]
    options = dict(words[1:] for words in said if words[0] == "options")
    assert ["softdep", "uio_pdrv_genirq", "pre:", "cm_window"] in said
    compatible = options["uio_pdrv_genirq"].removeprefix("of_id=")
    assert (ROOT / f"dts/bindings/{compatible}.yaml").exists()
    assert any(compatible in path.read_text() for path in (ROOT / "tests/golden").rglob("*.dtso"))


def test_the_sysv_script_says_where_it_starts() -> None:
    text = (SYSTEM / "sysv/cm").read_text()
    assert "### BEGIN INIT INFO" in text
    run("sh", "-n", str(SYSTEM / "sysv/cm"))
    assert unit("Service", "ExecStart")[0].split(" ", 1)[1] in text


def test_the_unit_is_a_file_that_its_readers_take() -> None:
    parser = ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read(UNIT)
    assert parser["Service"]["Type"] == "notify"
    assert parser["Service"]["WatchdogSec"]


def client_files() -> list[str]:
    """What debian/rules puts into the client's package, below cm/."""
    rules = (ROOT / "debian/rules").read_text()
    return ",".join(re.findall(r"^CLIENT := (?:\$\(CLIENT\),)?(\S+)$", rules, re.MULTILINE)).split(",")


def test_the_clients_debian_package_needs_no_other_for_a_client_and_for_ros_nodes(tmp_path: Path) -> None:
    for name in client_files():
        (tmp_path / "cm" / name).parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / "cm" / name).is_dir():
            shutil.copytree(ROOT / "cm" / name, tmp_path / "cm" / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / "cm" / name, tmp_path / "cm" / name)
    assert not list(tmp_path.rglob("*.so"))
    program = """
import importlib, pkgutil, cm, cm.aio
assert cm.connect and cm.aio.connect and cm.errors.CmError
names = [m.name for m in pkgutil.walk_packages(cm.__path__, "cm.") if m.name != "cm.client.register_window"]
for name in names:
    importlib.import_module(name)
print(cm.__file__, len(names))
"""
    where, count = run("env", "-C", str(tmp_path), f"PYTHONPATH={tmp_path}", sys.executable, "-c", program).split()
    assert Path(where).is_relative_to(tmp_path)
    assert int(count) > 90
