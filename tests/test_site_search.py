"""The search of the site in a real browser, over four small pages that are built here."""

import re
import shutil
import subprocess
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="there is no Chromium; apt-get install chromium"),
]
PAGES = {
    "index": "Start\n=====\n\n.. toctree::\n\n   all\n   freeze\n   nothing\n   passage\n   questions\n",
    "all": "A sensor drifts, freezes, jumps\n===============================\n\nSamples of each.\n",
    "freeze": "A sensor freezes\n================\n\nThe sample repeats, as in a broken encoder.\n",
    "nothing": "How do I get what I do?\n=======================\n\nWhy do I get it? I do.\n",
    "passage": "A long page\n===========\n\n" + "Words before, also a gearbox. " * 20 + "The torque of a gearbox.\n",
    "questions": "Answers\n=======\n\nMy encoder drifts slowly\n------------------------\n\nDrift is found late.\n",
}


class QuietHandler(SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    application = pytest.importorskip("sphinx.application")
    source, built = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("built")
    for name, text in PAGES.items():
        (source / f"{name}.rst").write_text(text, encoding="utf-8")
    settings = {"html_theme": "basic", "html_search_scorer": str(ROOT / "docs" / "_site" / "scorer.js")}
    application.Sphinx(source, None, built, built / "doctrees", "html", settings, status=None).build()
    handler = partial(QuietHandler, directory=built)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:  # a browser reads no passages from files
        threading.Thread(target=server.serve_forever).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def results_of(site, question):
    """Return the page's text from its results on."""
    command = [BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=4000", "--dump-dom"]
    address = f"{site}/search.html?q={question.replace(' ', '+')}"
    page = subprocess.run([*command, address], capture_output=True, text=True, timeout=120, check=True).stdout
    return page.partition('id="search-results"')[2]


def found(site, question):
    """Return the addresses of the results, best first."""
    results = results_of(site, question)
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


def test_words_of_a_question_do_not_count(site):
    assert found(site, "why do I get what drifts") == found(site, "drifts")


def test_words_of_a_question_alone_are_searched(site):
    assert found(site, "do I get")[0] == "nothing.html"


def test_the_passage_with_most_of_the_words_is_shown(site):
    shown = re.findall(r'<p class="context">(.*?)</p>', results_of(site, "torque gearbox"))[0]
    passage = re.sub(r"<[^>]+>", "", shown)  # words of the search are marked
    assert passage.endswith("The torque of a gearbox.")
    assert "A long page" not in passage
