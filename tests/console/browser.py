"""A real browser for the tests, and axe-core, which judges whether a page is accessible."""

import os
import shutil
import subprocess
import tarfile
import time
from pathlib import Path

import pytest

PATIENCE = 90
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")


def open_browser(folder: Path):
    """Return a headless Chromium that keeps downloads in a folder; skip the test if there is none."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    from selenium.common.exceptions import WebDriverException
    from selenium.webdriver.chrome.service import Service

    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip(f"there is no browser: none of {', '.join(BROWSERS)} is on the path")
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    options.add_experimental_option("prefs", {"download.default_directory": str(folder)})
    driver = shutil.which("chromedriver")
    try:
        opened = webdriver.Chrome(options=options, service=Service(driver) if driver else None)
    except WebDriverException as error:
        pytest.skip(f"the browser {browser} does not start: {error.msg}")
    opened.set_script_timeout(PATIENCE)
    return opened


def axe(tmp_path_factory) -> str:
    """Return the text of axe-core: the file that AXE_CORE names, else from npm; skip the test if there is none."""
    if file := os.environ.get("AXE_CORE"):
        return Path(file).read_text(encoding="utf-8")
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip("there is no axe-core: AXE_CORE names no file, and npm is not installed")
    folder = tmp_path_factory.mktemp("axe")
    done = subprocess.run(
        [npm, "pack", "axe-core@4", "--silent"], cwd=folder, capture_output=True, text=True, timeout=120
    )
    if done.returncode:
        pytest.skip(f"npm cannot bring axe-core: {done.stderr[-200:]}")
    with tarfile.open(folder / done.stdout.split()[-1]) as archive:
        return archive.extractfile("package/axe.min.js").read().decode()


def violations(browser, text):
    """Return what axe-core finds on the page that is shown."""
    browser.execute_cdp_cmd("Runtime.evaluate", {"expression": text})  # the page's policy lets no other script in
    return browser.execute_async_script(
        "const done = arguments[0]; axe.run().then((r) => done(r.violations.map((v) => "
        "[v.id, v.help, v.nodes.map((n) => n.html + ' ' + n.failureSummary)])))"
    )


class Page:
    """The page of a console."""

    def __init__(self, browser, address, status="You have"):
        self.browser = browser
        browser.get(address)
        self.until(lambda: self.text("#status").startswith(status))
        self.until(lambda: self.text("#clock") != "" and self.all(".card.healthy, .card.suspect, .card.faulty"))

    def until(self, condition, seconds=PATIENCE):
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, self.text("body")
            time.sleep(0.05)

    def all(self, selector):
        return self.browser.find_elements("css selector", selector)

    def one(self, selector):
        (found,) = self.all(selector)
        return found

    def text(self, selector):
        return self.browser.execute_script(
            "const e = document.querySelector(arguments[0]); return e ? e.textContent : ''", selector
        )

    def click(self, selector):
        element = self.one(selector)
        self.browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
        element.click()

    def set(self, selector, value):
        """Set a control as a user does, with the events of it."""
        script = """const e = document.querySelector(arguments[0]); e.value = arguments[1];
            for (const n of ['input', 'change']) e.dispatchEvent(new Event(n, {bubbles: true}));"""
        self.browser.execute_script(script, selector, value)

    def look(self, width, height=900, dark=False):
        """Set the size of the page, and its theme."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        theme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": theme})
        time.sleep(0.3)

    def seconds(self):
        return float(self.text("#clock").split()[0])
