"""The page in a real browser."""

import time

import numpy as np
import pytest
from browser import Page, axe, open_browser, violations
from served import served, until

from bayesftc.scenario import load_scenario

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def downloads(tmp_path_factory):
    return tmp_path_factory.mktemp("downloads")


@pytest.fixture(scope="module")
def browser(downloads):
    opened = open_browser(downloads)
    yield opened
    opened.quit()


@pytest.fixture(scope="module")
def address():
    with served("cruise_control") as (_, found):
        yield found


@pytest.fixture
def page(browser, address):
    shown = Page(browser, address)
    shown.look(1280)
    yield shown
    errors = [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert errors == []
    browser.get("about:blank")  # gives the controls back


def drawn(page, selector):
    """Return how many pixels of a canvas are not empty."""
    return page.browser.execute_script(
        """const c = document.querySelector(arguments[0]);
        const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
        let n = 0; for (let i = 3; i < d.length; i += 4) n += d[i] > 0; return n;""",
        selector,
    )


def test_break_go_back_branch_and_download(page, downloads):
    page.set("#pace", "10")
    page.click("#run")
    page.until(lambda: page.seconds() > 4.0)
    page.click("#run")
    assert drawn(page, "#scenes canvas") > 100
    assert drawn(page, "#strips canvas") > 100
    assert float(page.text("#loop .value")) > 0
    page.click("[aria-label='sensor 1'] > button")
    page.click("#form-sensor-1 button")
    page.until(lambda: "freeze from" in page.text("[aria-label='sensor 1'] .faults"))
    assert page.text("#message") == ""
    page.click("#run")
    page.until(lambda: page.all("[aria-label='sensor 1'].faulty"))
    page.until(lambda: page.text("[aria-label='sensor 1'] .words").startswith("ignoring sensor 1 since"))
    assert "frozen" in page.text("[aria-label='sensor 1'] .words")
    page.until(lambda: "sensor 1: alarm" in page.text("#log"))
    page.click("#run")
    assert "by hand: Freeze of sensor 1" in page.text("#log")

    page.set("#moment", "100")
    page.until(lambda: page.seconds() == 2.0)
    page.until(lambda: "freeze from" not in page.text("[aria-label='sensor 1'] .faults"))  # it was made later
    assert "Freeze of sensor 1" not in page.text("#log")
    page.click("[aria-label='actuator force'] > button")
    page.set("#kind-actuator-0", "GainFault")
    page.set("#actuator-0-factor", "0.3")
    page.click("#form-actuator-0 button")
    page.until(lambda: "branch 2" in page.text("#branch-list"))
    page.click("[aria-label='Compare with first']")
    page.until(lambda: len(page.all("#scenes figure")) == 3)
    page.click("#run")
    page.until(lambda: page.seconds() > 4.0)
    page.click("#run")
    assert "force_gain_fault_0 is present" in page.text("#cards")

    page.click("a[href='/download/scenario.toml']")
    file = downloads / "cruise_control_scenario.toml"
    page.until(file.is_file)
    end = page.seconds()
    result = load_scenario(file).simulate()
    assert result.time[-1] == pytest.approx(end, abs=0.2)
    assert np.array_equal(result["force_gain_fault_0.active"] > 0, result.time >= 2.01)
    page.click("a[href='/download/figure.png']")
    page.until((downloads / "cruise_control_figure.png").is_file)
    page.click("a[href='/download/events.csv']")
    page.until((downloads / "cruise_control_events.csv").is_file)
    assert "Freeze of sensor 1" in (downloads / "cruise_control_events.csv").read_text()
    page.set("#lane", "1")
    page.click("a[href='/download/scenario.toml?lane=1']")
    page.until((downloads / "cruise_control_FixedPrecision_scenario.toml").is_file)
    page.set("#lane", "0")
    page.click("[aria-label='Show first']")
    page.until(lambda: "freeze from" in page.text("[aria-label='sensor 1'] .faults"))
    page.click("[aria-label='Remove branch 2']")
    page.until(lambda: "branch 2" not in page.text("#branch-list"))


def test_keyboard(page):
    from selenium.webdriver.common.keys import Keys

    body = page.one("body")
    k = page.seconds()
    body.send_keys("s")
    page.until(lambda: page.seconds() > k)
    body.send_keys(Keys.SPACE)
    page.until(lambda: page.text("#run") == "Pause")
    body.send_keys(Keys.SPACE)
    page.until(lambda: page.text("#run") == "Run")
    reached = set()
    for _ in range(80):
        page.browser.switch_to.active_element.send_keys(Keys.TAB)
        reached.add(
            page.browser.execute_script(
                "const e = document.activeElement; return e.id || e.getAttribute('aria-label') || e.textContent"
            )
        )
    assert {"run", "step", "pace", "moment", "window", "more", "log", "Break sensor 0", "Set reference of v"} <= reached
    toggle = page.one("[aria-label='sensor 0'] > button")
    toggle.send_keys(Keys.ENTER)
    assert toggle.get_attribute("aria-expanded") == "true"
    slider = page.one("#form-sensor-0 input[type=range][aria-label^='duration']")
    slider.send_keys(Keys.ARROW_RIGHT)
    assert float(page.one("#sensor-0-duration").get_attribute("value")) > 0


def test_the_reference_shows_its_present_value_until_another_is_entered(page):
    box = "#settings input[type=number]"

    def value():
        return page.browser.execute_script("return Number(document.querySelector(arguments[0]).value)", box)

    page.set("#moment", "0")
    page.until(lambda: value() == 20.0)
    page.set(box, "23")
    page.click("[aria-label='Set reference of v']")
    page.click("#step")
    page.set("#moment", "0")
    page.until(lambda: value() == 20.0)
    page.set(box, "7")
    page.click("#step")
    time.sleep(0.3)
    assert value() == 7.0


def test_strips_of_a_paused_run_follow_the_width_of_the_window(page):
    page.click("#step")
    for width in (1280, 800, 390, 1280):
        page.look(width)
        page.until(lambda: strips_fit(page))


def test_the_window_fits_the_sample_time(page):
    """The strips of a slow plant show hours, with ticks in hours; the choice of the car is in seconds and minutes."""
    assert [option.text for option in page.all("#window option")] == ["5 s", "20 s", "1 min", "5 min", "all"]
    assert page.browser.execute_script("return document.querySelector('#window').value") == "20"
    script = """const done = arguments[0]; import('/page/strips.js').then((m) => done(
        [m.windows(60.0), m.windows(1e9)[1][0], m.unitOf(20)[0], m.unitOf(300)[0], m.unitOf(14400)[0]]))"""
    windows, longest, *units = page.browser.execute_async_script(script)
    assert windows == [[3600, "1 h"], [14400, "4 h"], [43200, "12 h"], [216000, "60 h"]]
    assert longest == 8640000
    assert units == ["s", "min", "h"]


def strips_fit(page):
    script = """return [...document.querySelectorAll('.strip canvas')].every((c) => Math.abs(
        c.getBoundingClientRect().width - c.closest('.strip').getBoundingClientRect().width) < 2)"""
    return page.browser.execute_script(script)


def test_errors_are_shown(page):
    page.click("[aria-label='sensor 0'] > button")
    page.set("#sensor-0-when", "condition")
    page.set("#sensor-0-start", "fast")
    page.click("#form-sensor-0 button")
    page.until(lambda: "give seconds, or a condition" in page.text("#message"))
    assert page.one("#message").get_attribute("role") == "alert"


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [1280, 390])
def test_accessible(page, tmp_path_factory, width, dark):
    text = axe(tmp_path_factory)
    page.look(width, dark=dark)
    page.click("[aria-label='sensor 0'] > button")
    page.click("#step")
    time.sleep(0.5)
    assert violations(page.browser, text) == []
    inner, outer = page.browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
    assert inner <= outer


def test_a_second_page_watches(page, browser):
    first = browser.current_window_handle
    address = browser.current_url
    browser.switch_to.new_window("tab")
    browser.get(address)
    page.until(lambda: "Another page has the controls" in page.text("#status"))
    page.until(lambda: page.all(".card.healthy, .card.faulty"))
    assert not page.one("#run").is_enabled()
    browser.close()
    browser.switch_to.window(first)


def test_a_pass_lets_a_browser_in_once(browser, tmp_path, monkeypatch):
    """The cookie is sent by no other site, but by the page to which the pass leads."""
    script, seen = tmp_path / "browser", tmp_path / "seen"
    script.write_text(f'#!/bin/sh\necho "$@" > {seen}.part\nmv {seen}.part {seen}\n')
    script.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{script} %s")
    with served("cruise_control", "--alone", "--host", "0.0.0.0", "--open"):
        until(seen.exists)
        opened = seen.read_text().strip().replace("0.0.0.0", "127.0.0.1")
        shown = Page(browser, opened)
        assert browser.current_url == opened.split("?")[0]
        (cookie,) = browser.get_cookies()
        assert (cookie["sameSite"], cookie["httpOnly"]) == ("Strict", True)
        shown.click("#step")
        shown.until(lambda: shown.seconds() > 0.0)
        browser.delete_all_cookies()
        browser.get(opened)
        assert "does not count any more" in shown.text("body")
        browser.get("about:blank")
