# SPDX-License-Identifier: Apache-2.0
"""A design is built anew under the same name while the board holds the build before it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from manager_schemas import DUO, PORTED, written
from manager_support import Rig, rig

from cm.errors import NotFound
from cm.manager.errors import NoSuchPlace, NothingLoaded
from cm.schema import load
from cm.schema.model import Config
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import ChangeMode, RegWrite

SWAPPED = DUO.replace("led: {offset: 0x18}", "led: {offset: 0x14}").replace(
    "scratch: {offset: 0x14}", "scratch: {offset: 0x18}"
)
MOVED = PORTED.replace("led: {offset: 0x18", "led: {offset: 0x14")


@pytest.fixture(scope="module")
def sim(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimBoard]:
    folder = tmp_path_factory.mktemp("configs")
    with SimBoard([c.source for c in written(folder).values() if c.source], arguments=["--icap-rate", "0"]) as board:
        yield board


Build = Callable[..., Config]


@pytest.fixture
def build(sim: SimBoard, tmp_path: Path) -> Build:
    """Writes a schema beside its bitstreams; those that were `rebuilt` are of another day."""
    folder = tmp_path / "design"
    folder.mkdir()

    def make(text: str, *rebuilt: str) -> Config:
        (folder / "schema.yaml").write_text(text, encoding="utf-8")
        config = load(folder / "schema.yaml")
        for name in (*config.modules, config.name):
            there = sim.root / "lib/firmware/cm" / config.name / f"{name}.bit"
            if there.exists():
                data = there.read_bytes()
                (folder / f"{name}.bit").write_bytes(
                    data.replace(b"2024/01/01", b"2026/01/01") if name in rebuilt else data
                )
        return config

    return make


def told(made: Rig) -> tuple[str, str, dict[str, str]]:
    status = made.manager.status()
    return status.config_name, status.mode, {region.name: region.state for region in status.regions}


def hold(sim: SimBoard, state: Path, config: Config, mode: str) -> None:
    with rig(sim.root, state, config) as first:
        assert first.go(mode, config=config.name) is None


def test_registers_of_a_region_that_holds_another_build_are_not_offered(
    sim: SimBoard, build: Build, tmp_path: Path
) -> None:
    hold(sim, tmp_path / "state", build(DUO), "default")
    new = build(SWAPPED, "a0")
    with rig(sim.root, tmp_path / "state", new) as made:
        made.manager.wait_idle()
        assert told(made) == ("", "", {"prr0": "unknown", "prr1": "ready"})
        assert made.notes == (
            "region prr0 holds another build of a0 than duo names now",
            "nothing of it is used until it is loaded: cm load duo",
        )
        with pytest.raises(NothingLoaded):
            made.manager.write_registers((RegWrite("led", 7),))
        assert [
            step.subject for step in made.manager.plan(ChangeMode("duo", "default")).steps if step.kind == "load"
        ] == ["prr0"]
        assert made.go("default", config="duo") is None
        made.manager.write_registers((RegWrite("led", 7),))
        place = made.devices.window(0x1014, 32)
        assert place.device.read(place.offset, 32, place.map) == 7


def test_a_whole_image_of_another_build_is_not_taken_for_the_schemas(
    sim: SimBoard, build: Build, tmp_path: Path
) -> None:
    hold(sim, tmp_path / "state", build(PORTED), "only")
    new = build(MOVED, "ported")
    with rig(sim.root, tmp_path / "state", new) as made:
        made.manager.wait_idle()
        assert told(made)[:2] == ("", "")
        assert made.notes[0] == "the device holds another build of ported than its schema names now"
        assert made.go("only", config="ported") is None
        assert made.manager.state.static_sha256 == made.files.static_image(new).sha256


def test_a_schema_that_says_more_of_the_same_build_leaves_the_board_as_it_is(
    sim: SimBoard, build: Build, tmp_path: Path
) -> None:
    hold(sim, tmp_path / "state", build(DUO), "default")
    with rig(
        sim.root, tmp_path / "state", build(DUO.replace("name: duo", "name: duo\n  doc: it was documented"))
    ) as made:
        made.manager.wait_idle()
        assert (told(made), made.notes) == (("duo", "default", {"prr0": "ready", "prr1": "ready"}), ())
        assert made.manager.plan(ChangeMode("duo", "default")).bytes == 0


@pytest.mark.parametrize(("unload", "there"), [("-prr1", ("duo", "")), ("-*", ("", ""))])
def test_of_an_unloaded_configuration_only_what_other_regions_hold_says_which_build_it_is(
    sim: SimBoard, build: Build, tmp_path: Path, unload: str, there: tuple[str, str]
) -> None:
    config = build(DUO)
    hold(sim, tmp_path / "state", config, "default")
    with rig(sim.root, tmp_path / "state", config) as made:
        assert made.go(unload, config="duo") is None
    with rig(sim.root, tmp_path / "state", build(f"# more\n{DUO}")) as made:
        assert told(made)[:2] == there


def test_an_unchanged_schema_needs_none_of_its_files_at_the_start(sim: SimBoard, build: Build, tmp_path: Path) -> None:
    config = build(DUO)
    hold(sim, tmp_path / "state", config, "default")
    for path in (tmp_path / "design").glob("*.bit"):
        path.write_bytes(b"not there yet")
    with rig(sim.root, tmp_path / "state", config) as made:
        assert told(made) == ("duo", "default", {"prr0": "ready", "prr1": "ready"})


@pytest.mark.parametrize("rebuilt", [(), ("a1",)])
def test_a_schema_sent_while_its_configuration_is_loaded_is_compared_in_the_same_way(
    sim: SimBoard, build: Build, tmp_path: Path, rebuilt: tuple[str, ...]
) -> None:
    with rig(sim.root, tmp_path / "state", build(DUO)) as made:
        assert made.go("default", config="duo") is None
        new = build(SWAPPED, *rebuilt)
        made.manager.add_config(new, made.manager.images_of(new))
        if rebuilt:
            assert told(made) == ("", "", {"prr0": "ready", "prr1": "unknown"})
            assert made.data_plane.runs[:2] == (None, None)
            with pytest.raises((NothingLoaded, NotFound)):
                made.manager.write_registers((RegWrite("depth", 7),))
            assert made.go("default", config="duo") is None
        assert told(made) == ("duo", "default", {"prr0": "ready", "prr1": "ready"})


@pytest.mark.parametrize(
    ("wrong", "what"),
    [
        (DUO.replace("led: {offset: 0x18}", "led: {offset: 0x9018, default: 1}"), "register led of duo, at 0xa018: "),
        (DUO.replace("{base_address: 0x1000, offset: 0x0, bit: 0}", "{base_address: 0xa000, offset: 0x0, bit: 0}"),
         "the decoupler of region prr0 of duo, at 0xa000: "),
        (DUO.replace("{base_address: 0x2000, offset: 0x1000}", "{base_address: 0xa000, offset: 0x1000}"),
         "the identity of region prr0 of duo, at 0xb000: "),
    ],
)  # fmt: skip
def test_an_address_that_no_device_of_the_board_has_is_told_before_the_first_step(
    sim: SimBoard, build: Build, tmp_path: Path, wrong: str, what: str
) -> None:
    with rig(sim.root, tmp_path / "state", build(DUO)) as made:
        assert made.go("default", config="duo") is None
        before = sim.control.state()["regions"]
        made.manager.add_config(build(wrong))
        with pytest.raises(NoSuchPlace, match=what):
            made.manager.plan(ChangeMode("duo", "other"))
        error = made.go("other", config="duo")
        assert (error.code, error.message.startswith(what)) == ("device_not_found", True)
        assert sim.control.state()["regions"] == before
