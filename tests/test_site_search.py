"""The search of the site in a real browser, over four small pages that are built here."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="there is no Chromium; apt-get install chromium"),
]
PAGES = {
    "index": "Start\n=====\n\n.. toctree::\n\n   all\n   freeze\n   questions\n",
    "all": "A sensor drifts, freezes, jumps\n===============================\n\nSamples of each.\n",
    "freeze": "A sensor freezes\n================\n\nThe sample repeats, as in a broken encoder.\n",
    "questions": "Answers\n=======\n\nMy encoder drifts slowly\n------------------------\n\nDrift is found late.\n",
}


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    application = pytest.importorskip("sphinx.application")
    source, built = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("built")
    for name, text in PAGES.items():
        (source / f"{name}.rst").write_text(text, encoding="utf-8")
    settings = {"html_theme": "basic", "html_search_scorer": str(ROOT / "docs" / "_site" / "scorer.js")}
    application.Sphinx(source, None, built, built / "doctrees", "html", settings, status=None).build()
    return built


def found(site, question):
    """Return the addresses of the results, best first."""
    command = [BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=4000", "--dump-dom"]
    address = f"{site.as_uri()}/search.html?q={question.replace(' ', '+')}"
    page = subprocess.run([*command, address], capture_output=True, text=True, timeout=120, check=True).stdout
    results = page.partition('id="search-results"')[2]
    return [re.sub(r"\?[^#]*", "", link) for link in re.findall(r'<a href="([^"]+)"', results) if ".html" in link]


def test_a_word_that_no_page_has_does_not_count(site):
    assert found(site, "encoder unheardof")


def test_a_page_with_every_word_comes_before_one_with_most(site):
    pages = found(site, "encoder broken sample")
    assert pages[0] == "freeze.html"


def test_of_two_titles_with_every_word_the_shorter_comes_first(site):
    pages = found(site, "sensor freezes")
    assert pages.index("freeze.html") < pages.index("all.html")


def test_a_page_with_most_words_is_found(site):
    assert "freeze.html" in found(site, "broken encoder late")


def test_a_section_is_found_by_its_heading(site):
    assert "questions.html#my-encoder-drifts-slowly" in found(site, "drifts encoder")
