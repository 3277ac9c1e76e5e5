# SPDX-License-Identifier: Apache-2.0
"""What `make wheel` and `make deb` wrote into build/release, by tools and readers that others wrote."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
RELEASE = ROOT / "build/release"
WHEELS = sorted(RELEASE.glob("*.whl"))
BINARY = [wheel for wheel in WHEELS if not wheel.stem.endswith("-any")]
DEBS = sorted(RELEASE.glob("*.deb"))
TOOLS = Path(sys.executable).parent
ABSENT = "nothing in build/release: `make wheel deb` writes it"


def run(command: Sequence[str | Path], **options: object) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False, **options)  # type: ignore[call-overload]
    assert done.returncode == 0, done.stdout + done.stderr
    return str(done.stdout)


def needs(tool: str) -> pytest.MarkDecorator:
    missing = not (TOOLS / tool).exists() and not shutil.which(tool)
    return pytest.mark.skipif(missing, reason=f"needs {tool}")


wheels = pytest.mark.skipif(not WHEELS, reason=ABSENT)
debs = pytest.mark.skipif(not DEBS, reason=ABSENT)


@wheels
@needs("twine")
def test_twine_takes_the_wheels() -> None:
    run([TOOLS / "twine", "check", "--strict", *WHEELS])


@wheels
@needs("check-wheel-contents")
def test_wheels_hold_what_wheels_hold() -> None:
    run([TOOLS / "check-wheel-contents", *WHEELS], cwd=ROOT)


@pytest.mark.parametrize("wheel", WHEELS or [pytest.param(None, marks=wheels)], ids=lambda w: w and w.stem)
def test_every_module_of_a_wheel_is_python(wheel: Path) -> None:
    """Generated ones too: what writes them is of the builder's distribution."""
    with zipfile.ZipFile(wheel) as archive:
        modules = [name for name in archive.namelist() if name.endswith(".py")]
        generated = {"networks/rmw_zenoh/_cm_interfaces", "schema/_validator", "wire/cm_pb2", "wire/messages/_proto"}
        generated |= {"client/_operations", "client/lease"}
        assert {f"cm/{name}.py" for name in generated} <= set(modules)
        for name in modules:
            compile(archive.read(name), name, "exec")


@needs("auditwheel")
@pytest.mark.parametrize("wheel", BINARY or [pytest.param(None, marks=wheels)], ids=lambda w: w and w.stem)
def test_the_platform_that_a_wheel_names_is_the_one_that_it_needs(wheel: Path) -> None:
    shown = " ".join(run([TOOLS / "auditwheel", "show", wheel]).split())
    assert f'platform tag: "{wheel.stem.split("-")[-1]}"' in shown


@needs("readelf")
@pytest.mark.parametrize("wheel", BINARY or [pytest.param(None, marks=wheels)], ids=lambda w: w and w.stem)
def test_the_module_is_stripped_and_names_no_folder_of_the_builder(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        module = Path(archive.extract("cm/device/native/_cm.abi3.so", tmp_path))
    assert not re.search(r"\(RUNPATH\)|\(RPATH\)", run(["readelf", "-d", module]))
    assert not re.search(r"\.symtab|\.debug", run(["readelf", "-SW", module]))
    assert str(ROOT).encode() not in module.read_bytes()


@wheels
def test_one_wheel_is_for_any_system_and_has_no_compiled_module() -> None:
    (wheel,) = (wheel for wheel in WHEELS if wheel not in BINARY)
    assert wheel.stem.endswith("-py3-none-any")
    with zipfile.ZipFile(wheel) as archive:
        assert not [name for name in archive.namelist() if name.endswith(".so")]


@wheels
def test_wheels_of_all_architectures_differ_in_the_module_only() -> None:
    contents = []
    for wheel in WHEELS:
        with zipfile.ZipFile(wheel) as archive:
            names = [name for name in archive.namelist() if not name.endswith((".so", "/RECORD", "/WHEEL"))]
            contents.append({name: archive.read(name) for name in names})
    assert all(content == contents[0] for content in contents)


@debs
@needs("dpkg-deb")
@pytest.mark.parametrize("package", ["fpga-cm", "fpga-cm-extra", "fpga-cm-axidma"])
def test_the_modules_package_builds_what_it_names_when_it_is_installed(tmp_path: Path, package: str) -> None:
    deb = next(path for path in DEBS if path.name.startswith(f"{package}-dkms_"))
    assert "common.postinst" in run(["dpkg-deb", "-I", deb, "postinst"])
    run(["dpkg-deb", "-x", deb, tmp_path])
    source = next(tmp_path.glob("usr/src/fpga-cm-*"))
    configuration = (source / "dkms.conf").read_text()
    named = re.findall(r'BUILT_MODULE_NAME\[\d\]="(\w+)"', configuration)
    (built,) = re.findall(r"CM_MODULES='([^']*)'", configuration)
    # make reads it to its end, as the kernel's build does, and every object has its source
    listing = "all: ; @echo $(obj-m) / $(foreach m,$(obj-m:.o=),$($m-y:.o=.c))"
    build = f"CM_MODULES := {built}\nsrc := {source}\ninclude {source}/Kbuild\n{listing}\n"
    modules, sources = run(["make", "-s", "-f", "-"], input=build).split("/", 1)
    assert sorted(modules.split()) == sorted(f"{name}.o" for name in built.split())
    assert set(built.split()) - set(named) <= {"cm_dma"}  # whose symbols others use
    assert all((source / name).is_file() for name in sources.split())


@debs
@needs("dpkg-deb")
def test_every_module_of_the_wheel_is_in_one_debian_package() -> None:
    with zipfile.ZipFile(WHEELS[0]) as archive:
        wanted = {
            name for name in archive.namelist() if name.startswith("cm/") and not name.startswith("cm/tools/bench/")
        }
    found: list[str] = []
    arch = next(deb for deb in DEBS if deb.name.startswith("fpga-cm_"))
    for deb in [arch, *(deb for deb in DEBS if deb.name.endswith("_all.deb"))]:
        listed = [line.split()[-1] for line in run(["dpkg-deb", "--contents", deb]).splitlines()]
        prefix = "./usr/lib/python3/dist-packages/"
        found += [name.removeprefix(prefix) for name in listed if name.startswith(f"{prefix}cm/")]
    files = [name for name in found if not name.endswith("/")]
    assert len(files) == len(set(files))
    assert set(files) == wanted


SETTINGS = tuple(f"etc/cm/bridge-{name}.conf" for name in ("ros", "fleet"))


@debs
@needs("dpkg-deb")
def test_the_service_is_in_the_package_with_its_files() -> None:
    deb = next(deb for deb in DEBS if deb.name.startswith("fpga-cm_"))
    listing = run(["dpkg-deb", "--contents", deb])
    for name in (
        "lib/systemd/system/cm.service", "lib/udev/rules.d/60-cm.rules", "usr/lib/tmpfiles.d/fpga-cm.conf",
        "etc/cm/cm.yaml", "usr/lib/modprobe.d/cm.conf", "usr/bin/cm",
        "lib/systemd/system/cm-bridge@.service", "lib/systemd/system/cm-bridge-reload.path",
        "lib/systemd/system/cm-bridge-reload.service", "usr/share/bash-completion/completions/cm", *SETTINGS,
    ):  # fmt: skip
        assert f"./{name}\n" in listing, name
    conffiles = run(["dpkg-deb", "--info", deb, "conffiles"]).split()
    assert {f"/{name}" for name in ("etc/cm/cm.yaml", *SETTINGS)} <= set(conffiles)


@debs
@needs("lintian")
def test_lintian_has_nothing_to_say() -> None:
    tags = "bogus-mail-host,bogus-mail-host-in-debian-changelog,initial-upload-closes-no-bugs"
    command = ["lintian", "--fail-on", "error,warning", "--suppress-tags", tags, *DEBS]
    assert not re.search(r"^[EW]:", run(command, env={**os.environ, "LC_ALL": "C"}), re.MULTILINE)
