# SPDX-License-Identifier: Apache-2.0
"""The page of `cm web` in a real browser: each of its states, changes by mouse and keyboard, and leaks.

Every state leaves a picture in $CM_WEB_SHOTS (default: build/web), for people to look at.
"""

from __future__ import annotations

import base64
import io
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from manager_process import REPOSITORY, Manager, patient, served, until
from PIL import Image
from web_leaks import changed, held
from web_support import WebServer, change, chromium, crowded, page_of, watch, web_server

from cm.simulation.software import Board as SimBoard
from cm.wire import cm_pb2 as pb
from cm.wire.messages.status import ConfigInfo, ModeInfo, RegisterInfo, RegValue, RegValues, Status, StreamStatus

pytestmark = pytest.mark.web
SHOTS = Path(os.environ.get("CM_WEB_SHOTS") or REPOSITORY / "build" / "web")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as started:
        yield started


@pytest.fixture(scope="module")
def camera() -> Iterator[tuple[Manager, SimBoard]]:
    with served() as both:
        yield both


@pytest.fixture(scope="module")
def server(camera: tuple[Manager, SimBoard]) -> Iterator[WebServer]:
    with web_server(camera[0].runtime, "--control") as started:
        yield started


@pytest.fixture
def page(camera: tuple[Manager, SimBoard], server: WebServer, browser: Any) -> Iterator[Any]:
    """The page of a board in the camera example's default mode."""
    with camera[0].connected() as board:
        board.load("camera", "default", force=True)
    with page_of(browser, server, color_scheme="dark") as opened:
        opened.wait_for_selector("li[data-mode=default][data-here=true]")
        yield opened


def shoot(page: Any, name: str) -> Image.Image:
    """Take a picture of a state, and check that it is not blank."""
    SHOTS.mkdir(parents=True, exist_ok=True)
    page.wait_for_timeout(150)  # until fading has ended
    data = page.screenshot(path=SHOTS / f"{name}.png", full_page=True)
    picture = Image.open(io.BytesIO(data)).convert("RGB")
    assert len(picture.getcolors(1 << 24)) > 50
    return picture


def pixels(page: Any, stream: str) -> np.ndarray[Any, Any]:
    """What a stream's canvas shows, as RGB."""
    url = page.evaluate(f"document.querySelector('article[data-stream={stream}] canvas').toDataURL()")
    with Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))) as image:
        return np.asarray(image.convert("RGB"))


def seen(page: Any, expression: str) -> None:
    """Wait for a condition in the page, whose security policy forbids playwright's own way."""
    until(lambda: page.evaluate(expression), 60)


# ---- states -----------------------------------------------------------------------------------


def test_the_board_and_its_frames_are_shown(page: Any, camera: tuple[Manager, SimBoard]) -> None:
    watch(page)
    with camera[0].connected() as board:
        assert page.text_content("#board") == board.status.board
        with board.stream("camera", timeout=60) as stream:
            frame = stream.read().copy()
    shown = pixels(page, "camera")
    assert shown.shape == (480, 640, 3)
    assert np.array_equal(shown[..., 0], shown[..., 1])
    assert abs(int(shown[..., 0].mean()) - int(frame.mean())) < 60  # the camera goes on to other photographs
    assert page.text_content("g[data-region=prr0] .module") == "default"
    assert "40.7 °C" in page.text_content("#device")
    until(lambda: "this page" in page.text_content("article[data-stream=camera] .flow"))
    seen(page, "document.querySelectorAll('.chart').length >= 5")
    shoot(page, "dark")


# Of what is visible: text smaller than 12 px (in a drawing, as it is drawn), and what is tapped smaller than 44 px.
SMALL_TEXT = """[...document.querySelectorAll('body *')].filter((node) => {
    const own = [...node.childNodes].some((kid) => kid.nodeType === 3 && kid.textContent.trim());
    if (!own || !node.getClientRects().length || !node.checkVisibility()) return false;
    const scale = node.ownerSVGElement ? node.getScreenCTM().a : 1;
    const size = parseFloat(getComputedStyle(node).fontSize) * scale;
    return size > 0 && size < 11.99;
}).map((node) => node.outerHTML)"""
SMALL_TARGETS = """[...document.querySelectorAll('button, select, input, summary')].filter((node) => {
    const box = node.getBoundingClientRect();
    return node.checkVisibility() && box.width && Math.min(box.width, box.height) < 43.9;
}).map((node) => node.outerHTML)"""


@pytest.mark.parametrize("width", [320, 390, 430])
def test_the_page_fits_a_phone(width: int, server: WebServer, browser: Any, page: Any) -> None:
    with page_of(browser, server, width=width, height=844, color_scheme="light", has_touch=True) as small:
        watch(small)
        small.wait_for_selector("[data-register=zoom]")
        small.click("[data-map=prr0] summary")
        small.wait_for_selector("[data-map=prr0] svg")
        assert small.evaluate("document.documentElement.scrollWidth") <= width
        assert small.evaluate("document.querySelector('header').offsetHeight") <= 56
        assert small.evaluate(SMALL_TEXT) == []
        assert small.evaluate(SMALL_TARGETS) == []
        logic, processor = (small.locator(f"#device {part}").bounding_box() for part in (".logic", ".processor"))
        assert logic["y"] > processor["y"] + processor["height"] - 1, "one above the other"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing(scheme: str, server: WebServer, browser: Any, page: Any) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="needs the extra [test-web]")
    with page_of(browser, server, color_scheme=scheme) as shown:
        watch(shown)
        shown.wait_for_selector("[data-register=zoom]")
        shown.click("[data-map=prr0] summary")
        shown.wait_for_selector("[data-map=prr0] svg")
        found = axe.Axe().run(shown).response["violations"]
    assert [(one["id"], [node["html"] for node in one["nodes"]]) for one in found] == []


def test_a_regions_frames_are_drawn_and_what_is_wrong_is_red(page: Any, camera: tuple[Manager, SimBoard]) -> None:
    page.click("[data-map=prr0] summary")
    page.wait_for_selector("[data-map=prr0] svg")
    drawn = "[...document.querySelectorAll('[data-map=prr0] svg title')].map((node) => node.textContent)"
    assert page.evaluate(drawn)[0] == "Region prr0 of camera: default"
    ((far, _),) = camera[1].control.upset("prr0", 1)
    page.click("[data-map=prr0] button")
    seen(page, f"{drawn}.some((text) => text.startsWith('frame {far:08X}') && text.endsWith('wrong'))")
    summary = "document.querySelector('[data-map=prr0] summary').textContent"
    seen(page, f"{summary}.includes('1 upsets, 0 repairs, 1 bits are wrong')")
    seen(page, "document.querySelector('#state').dataset.state === 'error'")
    assert page.inner_text("#state") == "prr0 is wrong"
    assert "1 bits wrong" in page.text_content("#device .region[data-region=prr0]")
    shoot(page, "map")
    change(page, "edge_detection")
    seen(page, f"{drawn}[0]?.endsWith('edge')")
    seen(page, "document.querySelector('#state').dataset.state === 'idle'")


def test_what_fails_is_told_in_one_place_and_marked_where_it_was_tapped(
    page: Any, camera: tuple[Manager, SimBoard]
) -> None:
    told = "#errors:not([hidden]) li"
    with camera[0].connected() as board, board.lease("region:prr0", seconds=60):
        page.click("li[data-mode=edge_detection] .go")
        page.wait_for_selector("li[data-mode=edge_detection] .go[data-refused]")
        assert "held_by" in page.inner_text(told)
        page.get_by_role("slider", name="focus").press("ArrowRight")
        page.wait_for_selector("[data-register=focus][data-refused]")
        assert page.locator("body :text('is held by')").count() == 1, "nowhere else"
        box = page.locator("#errors").bounding_box()
        assert box["y"] + box["height"] < 200, "it is seen wherever the page is scrolled to"
    change(page, "edge_detection")
    page.wait_for_selector("#errors", state="hidden")
    assert page.query_selector("li[data-mode=edge_detection] .go[data-refused]") is None
    page.click("#told")
    assert "held_by" in page.inner_text(told), "what was told is still to be read"


def test_the_theme_is_the_systems_until_one_is_chosen(page: Any) -> None:
    background = "getComputedStyle(document.body.parentNode).backgroundColor"
    dark = page.evaluate(background)
    page.click("#theme")
    assert page.evaluate(background) != dark
    shoot(page, "light")
    page.reload()
    page.wait_for_selector("body[data-link=up]")
    assert page.evaluate(background) != dark


def test_without_its_token_it_asks_for_it(server: WebServer, browser: Any) -> None:
    with page_of(browser, server, url=server.origin) as page:
        page.wait_for_selector("dialog[open]")
        assert page.text_content("#streams") == ""
        shoot(page, "token")
        page.fill("#token", server.token)
        page.keyboard.press("Enter")
        page.wait_for_selector("body[data-link=up]")
        assert server.token not in page.url


def test_a_page_that_may_look_offers_nothing_else(camera: tuple[Manager, SimBoard], browser: Any, page: Any) -> None:
    with web_server(camera[0].runtime) as looking, page_of(browser, looking) as other:
        other.wait_for_selector(".register")
        assert other.text_content("#rights") == "read-only"
        enabled = "[...document.querySelectorAll('.go, .register input, .register select, .register button')]"
        assert other.evaluate(f"{enabled}.length") > 8
        assert other.evaluate(f"{enabled}.every((node) => node.disabled || node.ariaDisabled === 'true')")
        shoot(other, "read-only")


def test_a_change_is_shown_step_by_step_and_a_region_that_it_left_cut_off(browser: Any, tmp_path: Path) -> None:
    with (
        served(schemas=patient(tmp_path)) as (manager, sim),
        web_server(manager.runtime, "--control") as server,
        page_of(browser, server) as page,
    ):
        assert page.text_content("#loaded") == "nothing loaded"
        shoot(page, "nothing-loaded")
        sim.control.inject("icap_stall", value=100_000)
        page.click("li[data-mode=edge_detection] .go")
        page.wait_for_selector("g[data-region=prr0].loading")
        seen(page, "document.querySelector('#progress progress').value > 0.1")
        assert "load prr0" in page.text_content("#progress")
        page.click("#progress button")
        shoot(page, "changing")
        sim.control.inject("icap_crc")
        sim.control.clear("icap_stall")
        page.wait_for_selector("#progress", state="hidden")
        page.wait_for_selector("#changes [data-state=failed]")
        page.wait_for_selector("g[data-region=prr0].failed")  # there was no mode to go back to
        assert "load_failed" in page.inner_text("#errors")
        assert page.get_attribute("#state", "data-state") == "error"
        shoot(page, "cut-off")


def test_a_change_that_fails_says_why_and_stays_in_the_list(page: Any, camera: tuple[Manager, SimBoard]) -> None:
    camera[1].control.inject("icap_crc", count=1)
    page.click("li[data-mode=colorise] .go")
    page.wait_for_selector("#changes [data-state=failed]")
    page.wait_for_selector("li[data-mode=colorise] .go[data-refused]")
    page.wait_for_selector("li[data-mode=default][data-here=true]")  # it went back
    page.wait_for_selector("#errors li")
    assert "load_failed" in page.inner_text("#errors li")
    page.click("#changes li:first-child summary")
    assert page.inner_text("#errors li").endswith(page.inner_text("#changes li:first-child details > p"))
    shoot(page, "failed")


def test_what_others_hold_is_shown_and_keeps_the_page_off(page: Any, camera: tuple[Manager, SimBoard]) -> None:
    with camera[0].connected() as board, board.lease("region:prr0", holder="calibration"):
        page.wait_for_selector("#leases code")
        assert page.text_content("#leases code") == "region:prr0"
        assert "calibration" in page.text_content("#leases")
        page.click("li[data-mode=colorise] .go")
        page.wait_for_selector("li[data-mode=colorise] .go[data-refused]")
        assert "held by calibration" in page.inner_text("#errors")
        before = board.registers["focus"]
        page.get_by_role("slider", name="focus").press("ArrowRight")
        page.wait_for_selector("[data-register=focus][data-refused]")
        seen(page, f"document.querySelector('[data-register=focus] input').value === '{before}'")
        shoot(page, "lease")
    seen(page, "!document.querySelector('#leases code')")


def test_a_manager_that_goes_is_reported_and_found_again(browser: Any) -> None:
    with served() as (manager, _), web_server(manager.runtime, "--control") as server, page_of(browser, server) as page:
        page.wait_for_selector(".go:not([aria-disabled=true])")
        manager.kill()
        page.wait_for_selector("body[data-link=manager]")
        assert "No manager" in page.inner_text("#banner")
        assert "systemctl start cm" in page.inner_text("#banner"), "what to do"
        assert page.get_attribute("li[data-mode=default] .go", "aria-disabled") == "true"
        shoot(page, "no-manager")
        manager.start()
        page.wait_for_selector("body[data-link=up]")
        page.wait_for_selector("#banner", state="hidden")


def test_a_signal_is_drawn_as_one(page: Any, camera: tuple[Manager, SimBoard]) -> None:
    with camera[0].connected() as board:
        board.load("camera", "loopback")
        for name in ("to_pl", "from_pl"):
            board.configure_stream(name, shape=(153600,), dtype="int16", force=True)
        wave = (20_000 * np.sin(np.linspace(0, 40, 153600))).astype(np.int16)
        page.click("article[data-stream=from_pl] button")

        def drawn() -> bool:
            board.write("to_pl", wave)
            return page.get_attribute("article[data-stream=from_pl]", "data-live") == "true"

        until(drawn, 60)
        assert "-2.000e+4 … 2.000e+4" in page.text_content("article[data-stream=from_pl] .readout")
        lines = series_seen(page, "from_pl")
        assert lines[0] > 500, "a curve"
        assert lines[1] == 0, "and one only"


def test_complex_samples_are_drawn_as_i_and_q_as_a_spectrum_and_as_points(
    page: Any, camera: tuple[Manager, SimBoard]
) -> None:
    card = "article[data-stream=from_pl]"
    samples = (0.5 * np.exp(-2j * np.pi * np.arange(4096) / 512)).astype(np.complex64)
    with camera[0].connected() as board:
        board.load("camera", "loopback")
        for name in ("to_pl", "from_pl"):
            board.configure_stream(name, shape=samples.shape, dtype="complex64", force=True)
        if page.get_attribute(card, "data-watched") != "true":  # it may run still for the page before
            page.click(f"{card} button")
        page.wait_for_selector(f"{card}[data-open=true]")

        def looks(view: str, mark: str) -> str:
            def drawn() -> bool:
                board.write("to_pl", samples)
                return mark in page.text_content(f"{card} .readout")

            if view:
                page.select_option(f"{card} select", label=view)
            until(drawn, 60)
            return str(page.text_content(f"{card} .readout"))

        looks("", "0.5000")
        assert page.inner_text(f"{card} .series").split() == ["I", "Q"]
        assert min(series_seen(page, "from_pl")) > 300
        assert "-6.0" in looks("Spectrum", "dB of full scale"), "half of full scale"
        shoot(page, "spectrum")
        looks("Constellation", "-0.5000 … 0.5000")
        curve, other = series_seen(page, "from_pl")
        assert curve > 300, "a circle"
        assert other == 0
        for width in (390, 820, 1400):
            page.set_viewport_size({"width": width, "height": 900})
            looks("Over time", "0.5000")
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            shoot(page, f"complex-{width}")


def series_seen(page: Any, stream: str) -> tuple[int, int]:
    """How many pixels of a signal's canvas have the first line's colour, and the second's."""
    style = "getComputedStyle(document.documentElement).getPropertyValue('--series-{}')"
    shown = pixels(page, stream).astype(int)
    found = []
    for line in (0, 1):
        colour = page.evaluate(style.format(line)).strip()
        wanted = [int(colour[at : at + 2], 16) for at in (1, 3, 5)]
        away = np.abs(shown - wanted).max(axis=2)
        found.append(int((away < 60).sum()))
    return found[0], found[1]


# ---- sixty registers ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def crowd(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Manager, WebServer]]:
    with (
        served(schemas=crowded(tmp_path_factory.mktemp("crowd"))) as (manager, _),
        web_server(manager.runtime, "--control") as server,
        manager.connected() as board,
    ):
        board.load("camera", "edge_detection")
        yield manager, server


NAMES = """[...document.querySelectorAll('.register')]
    .filter((node) => node.checkVisibility()).map((node) => node.dataset.register)"""


def test_sixty_registers_are_folded_by_module_found_by_a_word_and_ordered_by_change(
    crowd: tuple[Manager, WebServer], browser: Any
) -> None:
    with page_of(browser, crowd[1]) as page, crowd[0].connected() as board:
        page.wait_for_selector("[data-register=edge_filter_control_3]")
        late = "document.querySelector('[data-register=system_prefetch_threshold_high_2] .hex').textContent"
        seen(page, f"{late} === '0x00000003'")  # its first value, which is no change
        everything = page.evaluate(NAMES)
        assert len(everything) > 60
        groups = page.locator(".group h3").all_text_contents()
        assert groups == ["static part", "prr0", "prr0 · edge", "prr1"]
        page.click("[data-group=prr0] summary")
        seen(page, f"{NAMES}.length < {len(everything) - 20}")
        page.fill("input[type=search]", "capture fifo")
        found = [f"capture_fifo_status_{number}" for number in range(4)]
        assert page.evaluate(NAMES) == found, "found, though its module is folded"
        assert page.inner_text(".tools [role=status]") == f"4 of {len(everything)}"
        page.fill("input[type=search]", "")
        page.select_option(".tools select", label="last changed first")
        page.mouse.move(5, 5)
        page.evaluate("document.activeElement.blur()")
        board.registers["system_prefetch_threshold_high_2"] = 77
        seen(page, f"{NAMES}[0] === 'system_prefetch_threshold_high_2'")
        assert page.inner_text("[data-register=system_prefetch_threshold_high_2] .when").count(":") == 2
        status = page.locator("[data-register=capture_fifo_status_0] .value-row").all_inner_texts()
        assert [line.split() for line in status] == [["full", "0"], ["level", "0"], ["state", "idle"]]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 820, 1400])
def test_pictures_at_three_widths(width: int, scheme: str, crowd: tuple[Manager, WebServer], browser: Any) -> None:
    """To be looked at: build/web/WIDTH-SCHEME.png."""
    with page_of(browser, crowd[1], width=width, height=900, color_scheme=scheme) as shown:
        watch(shown)
        shown.wait_for_selector("[data-register=threshold]")
        shown.wait_for_selector("[data-chart=temperature] canvas")
        assert shown.evaluate("document.documentElement.scrollWidth") <= width
        cut = """[...document.querySelectorAll('.register .name')]
            .filter((node) => node.clientWidth && node.scrollWidth > node.clientWidth + 1)"""
        assert shown.evaluate(f"{cut}.length") == 0, "names wrap"
        tops = [shown.locator(part).bounding_box()["y"] for part in ("#device", "#charts", "#registers")]
        assert tops == sorted(tops)
        switch = shown.evaluate(
            "(() => { const s = getComputedStyle(document.querySelector('[role=switch]'), '::before');"
            " return [s.borderTopColor, getComputedStyle(document.querySelector('main section')).backgroundColor]; })()"
        )
        assert contrast(*switch) > 3, "an unchecked box can be seen (WCAG 2.2, 1.4.11)"
        shoot(shown, f"{width}-{scheme}")


def test_the_map_of_frames_is_dark_in_the_dark(page: Any) -> None:
    page.click("[data-map=prr0] summary")
    page.wait_for_selector("[data-map=prr0] svg")
    fill = "getComputedStyle(document.querySelector('[data-map=prr0] svg {}')).fill"
    paper, ink = (page.evaluate(fill.format(part)) for part in ("rect", "text"))
    assert contrast("rgb(0, 0, 0)", paper) < 2
    assert contrast(ink, paper) > 7


def contrast(one: str, other: str) -> float:
    """Of two colours `rgb(r, g, b)` (WCAG 2.2)."""

    def luminance(colour: str) -> float:
        shares = [int(part) / 255 for part in re.findall(r"\d+", colour)[:3]]
        linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in shares]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    high, low = sorted((luminance(one), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


# ---- changes ------------------------------------------------------------------------------------


def test_a_click_changes_the_mode_and_the_frames_with_it(page: Any, camera: tuple[Manager, SimBoard]) -> None:
    watch(page)
    change(page, "colorise")
    page.wait_for_selector("article[data-stream=camera][data-mode=colorise]")
    shown = pixels(page, "camera")
    assert not np.array_equal(shown[..., 0], shown[..., 2])
    assert page.text_content("g[data-region=prr0] .module") == "colorise"
    page.wait_for_selector("[data-register=palette]")
    assert page.query_selector("[data-register=threshold]") is None
    with camera[0].connected() as board:
        assert board.mode == "colorise"
    page.click("#changes li:first-child summary")
    assert "load prr0" in page.text_content("#changes li:first-child .legend")
    page.click("li[data-mode=edge_detection] summary")
    page.wait_for_selector("li[data-mode=edge_detection] .plan li")
    shoot(page, "colorise")


def test_all_of_it_works_by_keyboard(page: Any, camera: tuple[Manager, SimBoard]) -> None:
    page.focus("li[data-mode=edge_detection] .go")
    page.keyboard.press("Enter")
    page.wait_for_selector("li[data-mode=edge_detection][data-here=true]")
    page.wait_for_selector("[data-register=threshold]")
    assert page.evaluate("document.activeElement.closest('li')?.dataset.mode") == "edge_detection", "the focus stays"
    page.keyboard.press("Shift+Tab")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "edge_detection", "the loaded mode is in the order"
    page.get_by_role("slider", name="focus").focus()
    for _ in range(4):
        page.keyboard.press("ArrowRight")
    with camera[0].connected() as board:
        until(lambda: board.registers["focus"] == 5)
    page.get_by_role("combobox", name="led.blink").select_option(label="fast")
    with camera[0].connected() as board:
        until(lambda: board.registers["led.blink"] == 2)
        board.registers["zoom"] = 3  # by somebody else
    seen(page, "document.querySelector('[data-register=zoom] input').value === '3'")
    nameless = """[...document.querySelectorAll('button, input, select, canvas, [role=img]')].filter((node) =>
        !node.disabled && !(node.getAttribute('aria-label') || node.textContent.trim() || node.labels?.length))"""
    assert page.evaluate(f"{nameless}.map((node) => node.outerHTML)") == []


def test_a_value_that_comes_late_takes_no_step_of_a_slider_back(page: Any, camera: tuple[Manager, SimBoard]) -> None:
    late: list[str | bytes] | None = None
    ways: list[Any] = []

    def between(socket: Any) -> None:
        server = socket.connect_to_server()
        ways.append(socket)
        server.on_message(lambda message: socket.send(message) if late is None else late.append(message))

    page.route_web_socket("**/ws", between)
    page.reload()
    page.wait_for_selector("li[data-mode=default][data-here=true]")
    page.get_by_role("slider", name="focus").focus()
    late = []
    page.keyboard.press("ArrowRight")
    until(lambda: page.evaluate("1") and any(_focus(message) == 2 for message in late or []), 60)
    told, late = late, []
    page.keyboard.press("ArrowRight")
    for message in told:
        ways[-1].send(message)
    seen(page, "document.querySelector('[data-register=focus] .value').textContent === '2'")
    page.keyboard.press("ArrowRight")
    with camera[0].connected() as board:
        until(lambda: page.evaluate("1") and board.registers["focus"] == 4, 60)


def _focus(message: str | bytes) -> int | None:
    """The value of the register in a message to the page."""
    registers = json.loads(message).get("registers", {}) if isinstance(message, str) else {}
    return registers.get("focus", {}).get("value")


def test_interrupts_count_as_they_come(page: Any) -> None:
    watch(page)
    count = "Number(document.querySelector('[data-interrupt=frame_done] .value').textContent)"
    before = page.evaluate(count)
    seen(page, f"{count} > {before} + 5")


def test_a_hundred_changes_leave_nothing_behind(page: Any, server: WebServer) -> None:
    watch(page)
    changed(page, 30)  # until the lists are as long as they get
    before = held(page, server)
    changed(page, 99)
    after = held(page, server)
    print(before, after)
    assert after.nodes <= before.nodes * 1.1
    assert after.listeners <= before.listeners * 1.1
    assert after.heap <= before.heap + (
        2 << 20
    )  # a browser compiles and caches as it goes; 20 KiB a change would be a leak
    # A slow reader maps up to eight slots as it needs them; a leak would be one for each change.
    until(lambda: server.descriptors() <= before.descriptors + 8)
    assert after.resident <= before.resident + (8 << 10)


# ---- a record ---------------------------------------------------------------------------------


def test_the_slider_of_a_record_goes_to_any_moment(browser: Any, tmp_path: Path) -> None:
    """By key and by mouse, to both ends too; modes, values and frames are those of then."""
    pytest.importorskip("mcap", reason="records need mcap")
    from recording_support import write_record

    stream = StreamStatus("camera", "dma0", "s2mm", (48, 64), open=True)
    modes = ModeInfo("default"), ModeInfo("edge")
    at: dict[str, Any] = {"board": "kria", "started_ns": 1, "streams": (stream,)}
    events: list[tuple[float, str, Any]] = [
        (0.0, "cm_status", Status("camera", "default", sequence=1, **at)),
        (0.0, "cm_read_config", ConfigInfo("camera", modes=modes, registers=(RegisterInfo("focus", 16, 32, "ro"),))),
        (6.0, "cm_status", Status("camera", "edge", sequence=2, **at)),
    ]
    for number in range(1, 10):
        about = pb.Frame(stream="camera", sequence=number, shape=[48, 64], dtype="uint8")
        events.append((number + 0.0, "cm_read_reg", RegValues((RegValue("focus", number),), generation=number)))
        events.append((number + 0.0, "cm_frame/camera", pb.FrameSeen(frame=about, kept=True)))
        events.append((number + 0.0, "cm_stream/camera", bytes([20 * number]) * (48 * 64)))
    events.append((9.513, "cm_read_reg", RegValues((RegValue("focus", 99),), generation=10)))
    record = write_record(tmp_path / "night.mcap", sorted(events, key=lambda event: event[0]))
    with web_server(None, "--record", str(record)) as server, page_of(browser, server) as page:
        assert page.text_content("#record-name") == "night.mcap"
        assert page.text_content("#link") == "a record"

        def shows(mode: str, focus: int, grey: int) -> None:
            until(lambda: page.get_attribute(f"li[data-mode={mode}]", "data-here") == "true")
            until(lambda: page.evaluate(FOCUS) == str(focus))
            until(lambda: set(pixels(page, "camera").ravel()) == {grey})

        watch(page)
        shows("edge", 99, 180)  # it begins with the end
        page.focus("#when")
        page.keyboard.press("Home")
        until(lambda: page.get_attribute("li[data-mode=default]", "data-here") == "true")
        for _ in range(70):
            page.keyboard.press("ArrowRight")  # 3.5 s
        shows("default", 3, 60)
        page.keyboard.press("End")
        shows("edge", 99, 180)
        box = page.locator("#when").bounding_box()
        page.mouse.click(box["x"] + box["width"] * 0.58, box["y"] + box["height"] / 2)  # 5.5 s
        shows("default", 5, 100)


FOCUS = "document.querySelector('[data-register=focus] .value')?.textContent"
