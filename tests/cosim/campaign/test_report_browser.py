"""A report in a real browser: by day, by night, on a narrow screen and in print."""

import html
import json
import shutil
import subprocess

import numpy as np
import pytest

from bayesftc.scenario.campaigns import load_campaign

pytest.importorskip("zarr", reason="stores need the extra 'campaign'")
pytest.importorskip("jinja2", reason="reports need the extra 'campaign'")

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="there is no Chromium; apt-get install chromium"),
]

FILE = """
scenario = "cruise_control"
seeds = 3
duration = 8.0
record = ["plant.v", "reference.y", "controller.beta", "controller.fault_probability", "freeze_0.active"]

[[metrics]]
kind = "rmse"
signal = "plant.v"
reference = "reference.y"
shift = 1
name = "root mean square of the error of the speed against the reference"

[factors]
"faults[0].start" = [2.0, 4.0]
"plant.parameters.m" = [80.0, 100.0, 120.0]

[factors."controller.precision"]
"gamma with a name that is much longer than names should be" = { kind = "gamma_precision", forgetting = 0.9 }
switching = { kind = "switching_precision", joint = false }
"""

# What a page says of itself: how wide it is, its colours, and of each text how large it is and whether it is cut off.
PROBE = """<script>
window.complaints = [];
window.addEventListener("error", e => window.complaints.push(e.message));
window.addEventListener("load", () => {
  const body = getComputedStyle(document.body);
  const out = document.createElement("pre");
  out.id = "probe";
  out.textContent = JSON.stringify({
    inner: document.documentElement.clientWidth,
    scroll: document.documentElement.scrollWidth,
    ink: body.color, paper: body.backgroundColor, complaints: window.complaints,
    figures: [...document.querySelectorAll("figure svg")].map(s => [s.getBoundingClientRect().width,
      s.getBoundingClientRect().height]),
    ticks: [...document.querySelectorAll("figure svg g[id*=xtick] g[style]")].slice(0, 3).map(g => getComputedStyle(g).fill),
    headings: [...document.querySelectorAll("h2")].filter(h => h.getBoundingClientRect().height > 0).length,
    aligned: [...document.querySelectorAll("table")].every(t => [...t.querySelectorAll("th")].every((h, i) =>
      [...t.querySelectorAll("tbody tr")].every(r => getComputedStyle(r.cells[i]).textAlign == getComputedStyle(h).textAlign))),
  });
  document.body.append(out);
});
</script></head>"""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """Return the file of a report, and of the same one with a probe in it."""
    from bayesftc.cosim.campaign.store.folder import CampaignStore
    from bayesftc.report.page import report

    folder = tmp_path_factory.mktemp("report")
    (folder / "tracking.toml").write_text(FILE)
    load_campaign(folder / "tracking.toml").run(folder / "tracking")
    text = report(CampaignStore.open(folder / "tracking"))
    assert "<script" not in text
    (folder / "report.html").write_text(text, encoding="utf-8")
    (folder / "probed.html").write_text(text.replace("</head>", PROBE), encoding="utf-8")
    return folder


@pytest.fixture
def browse(tmp_path):
    """Run the browser, and return what it prints."""

    def browse(*options, page):
        command = [
            BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--enable-logging=stderr", "--v=0",
            f"--user-data-dir={tmp_path / 'profile'}", *options, page.as_uri(),
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr[-2000:]
        assert "CONSOLE" not in done.stderr, done.stderr[-2000:]
        return done.stdout

    return browse


DARK = ("--blink-settings=preferredColorScheme=0",)


def probed(text):
    return json.loads(html.unescape(text.split('<pre id="probe">')[1].split("</pre>")[0]))


def brightness(colour):
    return np.mean([float(part) for part in colour[colour.index("(") + 1 : -1].split(",")[:3]])


@pytest.mark.parametrize("width", [1100, 500])  # headless Chromium has no narrower window
@pytest.mark.parametrize("night", [False, True], ids=["day", "night"])
def test_a_page_fits_and_is_read_by_day_and_by_night(page, browse, width, night):
    options = [f"--window-size={width},4000", *(DARK if night else ())]
    found = probed(browse("--dump-dom", *options, page=page / "probed.html"))
    assert found["complaints"] == []
    assert found["inner"] == width
    assert found["scroll"] <= width
    paper, ink = brightness(found["paper"]), brightness(found["ink"])
    assert (paper < 60 and ink > 190) if night else (paper > 230 and ink < 60)
    assert len(found["figures"]) >= 4
    assert all(w >= 400 and h >= 100 for w, h in found["figures"])
    assert found["ticks"]
    assert set(found["ticks"]) == {found["ink"]}  # figures have the ink of the page
    assert found["headings"] >= 6
    assert found["aligned"]


@pytest.mark.parametrize("night", [False, True], ids=["day", "night"])
def test_a_picture_of_it_is_neither_blank_nor_of_the_wrong_brightness(page, browse, tmp_path, night):
    from matplotlib.image import imread

    browse(
        f"--screenshot={tmp_path / 'shot.png'}", "--window-size=1100,3000", *(DARK if night else ()),
        page=page / "report.html",
    )  # fmt: skip
    pixels = imread(tmp_path / "shot.png")[..., :3]
    grey = pixels.mean(axis=2)
    assert (np.median(grey) < 0.25) if night else (np.median(grey) > 0.9)
    inked = (grey > 0.6) if night else (grey < 0.5)
    assert 0.005 < inked.mean() < 0.3
    assert all(part.any() for part in np.array_split(inked[:2400], 8))  # from top to bottom there is something
    assert (np.ptp(pixels, axis=2) > 0.3).mean() > 0.005  # curves and maps have colours


def test_it_is_printed_on_pages_that_are_not_blank(page, browse, tmp_path):
    pdf = tmp_path / "report.pdf"
    browse(f"--print-to-pdf={pdf}", "--no-pdf-header-footer", page=page / "report.html")
    if shutil.which("pdftotext") is None:
        pytest.skip("reading the print needs pdftotext; apt-get install poppler-utils")
    text = subprocess.run(["pdftotext", "-layout", pdf, "-"], capture_output=True, text=True, check=True).stdout
    sheets = text.rstrip("\f").split("\f")
    assert 3 <= len(sheets) <= 12
    assert all(len(sheet.split()) > 5 for sheet in sheets)
    for heading in ("Results", "Comparison", "Over time", "Detection", "Settings", "bayesftc replay"):
        assert heading in text
