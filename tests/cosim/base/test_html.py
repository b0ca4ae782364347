"""What a notebook shows in place of a repr: tables and drawings, well-formed and escaped."""

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.controllers.registry import LEARNERS
from bayesftc.cosim.base.html import LENGTH, text_of
from bayesftc.scenario import load_scenario


@pytest.fixture(scope="module")
def loop():
    return load_scenario("cruise_control").loop()


def cells(thing):
    """The cells of each row of a table, which must be well-formed."""
    tree = ElementTree.fromstring(f"<body>{thing._repr_html_()}</body>")
    return [[cell.text or "" for cell in row] for row in tree.iter("tr")]


def test_a_result_has_its_signals_with_units_and_ranges(loop):
    result = loop.simulate(0.2, seed=1, engine="interpreted")
    rows = {row[0]: row[1:] for row in cells(result)}
    assert list(rows) == ["signal", *result]
    v = result["plant.v"]
    assert rows["plant.v"] == ["1", "m/s", f"{v.min():.4g}", f"{v.max():.4g}"]
    assert rows["controller.mode_probability"][0] == "2 x 8"
    assert repr(result) == "<Result: 21 signals, 11 rows to t = 0.2 s>"


def test_a_controller_has_its_settings_and_the_sizes_of_its_model(loop):
    rows = dict(cells(load_scenario("cruise_control").controller))
    assert rows["model"] == "LinearModel: 1 state, 1 control, 2 sensors, dt = 0.02 s"
    assert rows["precision"] == "SwitchingPrecision()"
    assert rows["inputs"] == "y(2), goal(1)"
    assert dict(cells(load_scenario("cruise_control").controller.model))["C"] == "[[1.]\n [1.]]"


@pytest.mark.parametrize("learner", LEARNERS)
def test_learners_have_their_settings(learner):
    assert {row[0] for row in cells(learner())} == set(learner.__dataclass_fields__)


def test_every_block_of_a_loop_and_faults_before_they_have_a_place(loop):
    for node in loop.nodes:
        assert cells(node.block)
    assert ["start", "3.0"] in cells(cosim.Freeze(start=3.0))


def test_campaigns_have_their_factors_and_their_runs(loop):
    campaign = cosim.Campaign(
        loop, duration=0.1, seeds=2, grid={"freeze_0.start": [0.02, 0.04]}, metrics=[cosim.Final("plant.v", name="v")]
    )
    assert ["freeze_0.start", "0.02, 0.04"] in cells(campaign)
    assert ["metrics", "v"] in cells(campaign)
    shown = cosim.CampaignResult(lambda: _table(), lambda: None)._repr_html_()
    assert "1 runs" in shown
    assert "&lt;b&gt;" in shown
    assert "<b>x" not in shown


def _table():
    import pandas as pd

    return pd.DataFrame({"status": ["ok"], "reason": ["<b>x"]})


@dataclass(frozen=True)
class Named(cosim.Gain):
    label: str = "<script>alert(1)</script> & more"


def test_what_users_write_is_escaped():
    assert "<script>" not in Named(1.0)._repr_html_()
    assert ["label", "<script>alert(1)</script> & more"] in cells(Named(1.0))


def test_long_values_are_short():
    assert text_of(np.zeros((100, 3))) == "100 x 3 numbers"
    assert len(text_of("x" * 10_000)) == LENGTH
    assert len(text_of(list(range(10_000)))) == LENGTH
