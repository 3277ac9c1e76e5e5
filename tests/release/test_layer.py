# SPDX-License-Identifier: Apache-2.0
"""meta-cm, by a checker of our own: what oelint and a parse of BitBake do not see."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from recipe import LAYER, PACKAGE, ROOT, depends, files_of, needed, owner, variables

from cm._version import __version__

RECIPES = sorted(LAYER.rglob("*.bb"))
MAIN = LAYER / f"recipes-cm/fpga-cm/python3-fpga-cm_{__version__}.bb"
OELINT = shutil.which("oelint-adv", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}") or ""
KAS = str(Path(OELINT).with_name("kas")) if OELINT else ""
SERIES = ("scarthgap", "wrynose")
SUFFIXES = ("", "-client", "-sim", "-build", "-bench", "-web", "-bridge")


# The project has no public home yet that they could name, and overlays and modules have no native variant.
SUPPRESSED = (
    "--suppress=oelint.var.mandatoryvar.HOMEPAGE",
    "--suppress=oelint.var.suggestedvar.BUGTRACKER",
    "--suppress=oelint.var.bbclassextend",
)


def dependencies(suffix: str) -> set[str]:
    """What a package depends on, through our own packages too."""
    listed = depends(variables(MAIN), suffix)
    ours = {name.removeprefix("${PN}") for name in listed if name.startswith("${PN}")}
    return {name for name in listed if not name.startswith("${PN}")}.union(*(dependencies(each) for each in ours))


def modules(suffix: str) -> list[Path]:
    files = files_of(MAIN)
    return [path for path in PACKAGE.rglob("*.py") if owner(path, files) == suffix]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_package_depends_on_what_its_modules_import(suffix: str) -> None:
    missing = {name for path in modules(suffix) for name in needed(path) - dependencies(suffix)}
    assert not missing


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_package_depends_on_nothing_that_its_modules_do_not_import(suffix: str) -> None:
    listed = depends(variables(MAIN), suffix)
    used = {name for path in modules(suffix) for name in needed(path)}
    assert {name for name in listed if not name.startswith("${PN}")} <= used


def test_every_folder_of_the_package_is_in_one_package() -> None:
    listed = [name for patterns in files_of(MAIN).values() for name in patterns if "*" not in name]
    assert len(listed) == len(set(listed))
    assert all((PACKAGE / name).exists() for name in listed)


@pytest.mark.parametrize("recipe", RECIPES, ids=lambda path: path.stem)
def test_licence_checksums_are_those_of_the_texts(recipe: Path) -> None:
    values = variables(recipe)
    folder = values.get("S", "").partition("${PV}")[2].strip("/")
    below = ROOT / re.sub(r"\$\{(\w+)\}", lambda found: values[found[1]], folder)
    for name, digest in re.findall(r"file://(\S+);md5=(\w+)", values.get("LIC_FILES_CHKSUM", "")):
        assert hashlib.md5((below / name).read_bytes()).hexdigest() == digest, name
    assert "LIC_FILES_CHKSUM" in values or "inherit packagegroup" in recipe.read_text() or values["LICENSE"] == "MIT"


@pytest.mark.parametrize("recipe", [*RECIPES, *LAYER.rglob("*.bbappend")], ids=lambda path: path.stem)
def test_files_of_a_recipe_are_in_the_layer(recipe: Path) -> None:
    text = " ".join(value for name, value in variables(recipe).items() if name.startswith("SRC_URI"))
    for name in re.findall(r"file://([\w.\-]+)", text):
        places = [recipe.parent / "files", recipe.parent / recipe.stem.split("_")[0], recipe.parent]
        assert name == "fpga_cm-" or any((place / name).exists() for place in places), name


def test_versions_are_that_of_the_package() -> None:
    assert {path.stem.split("_")[1] for path in RECIPES if "_" in path.stem} == {__version__}


def test_what_is_installed_is_in_the_tree() -> None:
    text = MAIN.read_text()
    for name in re.findall(r"\$\{S\}/([\w./\-]+)", text):
        assert (ROOT / name).exists(), name


def test_the_group_of_the_rules_is_made_by_each_package_that_needs_it() -> None:
    values = variables(MAIN)
    for package in values["USERADD_PACKAGES"].split():
        assert values[f"GROUPADD_PARAM:{package}"].split()[-1] == "fpga"
    assert values["USERADD_PARAM:${PN}"].split()[-1] == "cm"


def test_the_packagegroup_names_every_module_but_those_for_other_programs_and_the_simulated_pl() -> None:
    values = variables(LAYER / "recipes-cm/packagegroups/packagegroup-cm.bb")
    built = set(re.findall(r"^CM_MODULES \?= (.*)$", (ROOT / "kmod/Kbuild").read_text(), re.MULTILINE)[0].split())
    wanted = {f"kernel-module-{name.replace('_', '-')}" for name in built - {"cm_axidma_compat"}}
    board = {name for name in values["RDEPENDS:${PN}"].split() if name.startswith("kernel-")}
    simulated = {name for name in values["RDEPENDS:${PN}-sim"].split() if name.startswith("kernel-")}
    assert simulated == {"kernel-module-cm-plsim"}
    assert board == wanted


def test_bitbake_knows_beforehand_the_packages_that_modules_become() -> None:
    group = variables(LAYER / "recipes-cm/packagegroups/packagegroup-cm.bb")
    pattern = variables(LAYER / f"recipes-cm/fpga-cm/cm-kmod_{__version__}.bb")["PACKAGES_DYNAMIC"]
    names = [name for value in group.values() for name in value.split() if name.startswith("kernel-module-")]
    assert names
    assert all(re.match(pattern, name) for name in names)


def provided() -> set[str]:
    """Every package that the layer makes."""
    names = set()
    for recipe in RECIPES:
        values, base = variables(recipe), recipe.stem.split("_")[0]
        listed = f"{values.get('PACKAGES', '${PN}')} {values.get('PACKAGE_BEFORE_PN', '')} ${{PN}}"
        names |= {name.replace("${PN}", base) for name in listed.split()}
    group = variables(LAYER / "recipes-cm/packagegroups/packagegroup-cm.bb")
    return names | {name for value in group.values() for name in value.split() if name.startswith("kernel-module-")}


def test_packages_that_generated_files_name_are_made_by_the_layer() -> None:
    golden = ROOT / "tests/golden"
    texts = [path.read_text() for path in [*golden.rglob("user-rootfsconfig"), *golden.rglob("*.bb")]]
    named = {name for text in texts for name in re.findall(r"^CONFIG_([\w-]+)", text, re.MULTILINE)}
    named |= {name for text in texts for name in re.findall(r"[\"\s](python3-fpga-cm[\w-]*|packagegroup-cm)", text)}
    assert named
    assert {name for name in named if not name.startswith("cm-config-")} <= provided()


def test_classes_that_generated_recipes_inherit_are_in_the_layer() -> None:
    recipes = list((ROOT / "tests/golden").rglob("*.bb"))
    assert recipes
    for recipe in recipes:
        assert (
            LAYER / f"classes/{re.findall(r'^inherit (.+)$', recipe.read_text(), re.MULTILINE)[0]}.bbclass"
        ).exists()


def test_the_layer_says_what_yocto_check_layer_asks_for() -> None:
    text = (LAYER / "README.md").read_text()
    series = re.search(r'LAYERSERIES_COMPAT_cm = "(.*)"', (LAYER / "conf/layer.conf").read_text())
    assert (LAYER / "SECURITY.md").exists()
    assert (LAYER / "COPYING.MIT").exists()
    for layer in ("openembedded-core", "meta-openembedded"):
        assert re.search(rf"URI: \S+{layer}", text)
    assert re.search(r"[\w.]+@[\w.]+", text)
    assert series is not None
    assert series[1].split() == list(SERIES)


def test_what_is_there_for_ros_takes_what_its_packages_say() -> None:
    for recipe in (LAYER / "dynamic-layers/ros2").rglob("*.bb"):
        values = variables(recipe)
        said = ElementTree.parse(ROOT / "ros2" / values["ROS_BPN"] / "package.xml")
        wanted = {node.text for kind in ("depend", "exec_depend") for node in said.findall(kind)}
        if "python3-fpga-cm-client" in wanted:  # whose part for networks is a package of its own in the layer
            wanted.remove("python3-fpga-cm-client")
            assert "python3-fpga-cm-bridge" in values["RDEPENDS:${PN}"].split()
        assert set(values["ROS_EXEC_DEPENDS"].split()) == {str(name).replace("_", "-") for name in wanted}


def test_kas_files_are_there_for_each_series() -> None:
    assert {path.stem for path in (LAYER / "kas").glob("*.yml")} == {"base", *SERIES}


@pytest.mark.skipif(not OELINT, reason="needs oelint-adv")
@pytest.mark.parametrize("series", SERIES)
def test_oelint_finds_nothing(series: str) -> None:
    files = map(str, [*RECIPES, *LAYER.rglob("*.bbappend")])
    command = [OELINT, "--quiet", f"--release={series}", *SUPPRESSED, *files]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.skipif(not OELINT, reason="needs kas")
@pytest.mark.parametrize("series", SERIES)
def test_kas_understands_the_files_of_each_series(series: str, tmp_path: Path) -> None:
    """Without a network: the layers of others are empty folders here."""
    for name in ("openembedded-core/meta", "openembedded-core/bitbake", "meta-openembedded"):
        (tmp_path / name).mkdir(parents=True)
    offline = tmp_path / "offline.yml"
    names = ("openembedded-core", "meta-openembedded", "bitbake")
    places = {name: tmp_path / ("openembedded-core/bitbake" if name == "bitbake" else name) for name in names}
    repositories = "".join(f"  {name}: {{url: null, branch: null, path: {place}}}\n" for name, place in places.items())
    offline.write_text(f"header: {{version: 14}}\nrepos:\n{repositories}")
    kas = tmp_path / "yocto/meta-cm/kas"
    shutil.copytree(LAYER, kas.parent)
    files = ":".join(map(str, (kas / "base.yml", kas / f"{series}.yml", offline)))
    environment = {**os.environ, "KAS_WORK_DIR": str(tmp_path)}
    command = [KAS, "dump", files]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "meta-python" in done.stdout
    assert "cm-image-example" in done.stdout
