"""``bayesftc replay STORE RUN --serve``: a run of a campaign on the page."""

import numpy as np
import pytest
from served import Viewer, get, served
from typer.testing import CliRunner

from bayesftc import cosim
from bayesftc.cli.application import app
from bayesftc.cosim.campaign.store.folder import CampaignStore
from bayesftc.scenario import load_scenario

pytest.importorskip("zarr", reason="stores need the extra 'campaign'")

FILE = """
scenario = "cruise_control"
seeds = 2
duration = 2.0
record = ["plant.v", "controller.u"]

[[metrics]]
kind = "rmse"
signal = "plant.v"
reference = "reference.y"

[factors]
"plant.parameters.m" = [80.0, 100.0]
"""


def invoke(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments)])


@pytest.mark.slow
def test_a_stored_run_is_shown_and_continued(tmp_path):
    (tmp_path / "tracking.toml").write_text(FILE)
    done = invoke("campaign", tmp_path / "tracking.toml", "--out", tmp_path / "store", "-q")
    assert done.exit_code == 0, done.output
    stored = CampaignStore.open(tmp_path / "store").dataset()
    with served(str(tmp_path / "store"), "3", command=("replay", "--serve")) as (_, address), Viewer(address) as viewer:
        viewer.ready()
        assert viewer.layout["scenario"] == "store run 3"
        assert viewer.header["k"] == viewer.header["furthest"] == 100
        assert np.array_equal(stored["plant.v"][3].to_numpy().astype(np.float32), viewer.column("plant.v"))
        file = tmp_path / "run3.toml"
        file.write_bytes(get(address, "/download/scenario.toml")[2])
        again = load_scenario(file).simulate()
        for name in ("plant.v", "controller.u"):
            assert np.array_equal(stored[name][3].to_numpy(), again[name])
        viewer.do(do="back", k=20)
        viewer.do(do="fault", target="sensors", settings={"kind": "Freeze", "sensor": 1})
        viewer.do(do="step", steps=50)
        viewer.until(lambda: viewer.header["k"] == 70)
        assert viewer.layout["branches"][1]["parent"] == "first"


def test_a_loop_made_in_python_is_refused(tmp_path):
    diagram = cosim.Diagram(dt=0.1)
    diagram.add(cosim.Sine(amplitude=1.0, period=4.0), "sine")
    cosim.Campaign(diagram, duration=2.0, grid={"sine.amplitude": [1.0]}, seeds=1, record=["sine.y"]).run(
        tmp_path / "w"
    )
    done = invoke("replay", tmp_path / "w", 0, "--serve")
    assert done.exit_code != 0
    assert "is made in Python. Leave --serve out" in " ".join(done.output.split())
