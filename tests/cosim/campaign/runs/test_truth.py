"""The true faults that a campaign keeps beside a score of the controller."""

from dataclasses import dataclass

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim
from bayesftc.cosim.campaign.runs.truth import FAULTY, MISSING

PLANT = control.ss([[0.9]], [[0.1]], [[1.0]], 0, 0.1)
MODEL = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-3, 0.04, dt=0.1)


def loop(fault):
    return cosim.closed_loop(
        cosim.StateSpace(PLANT), controllers.BayesianController(MODEL), control="u", measured="y",
        sensors=cosim.Sensors(2, 0.2), faults=[fault], reference=1.0,
    )  # fmt: skip


def first():
    return cosim.Freeze(sensor=0, start=2.0, stop=4.0)


def ones(beta):
    beta[:] = 1.0


@dataclass(frozen=True)
class Alone(cosim.Block):
    """A block with the score of a controller, but without a loop."""

    outputs = (cosim.Port("beta", (2,)),)

    def define(self, step):
        return cosim.Definition(ones)


def campaign(**options):
    kinds = {
        "stuck": cosim.Injection(sensor=1, start=1.0, stop=4.0, magnitude=3.0),
        "gone": cosim.Dropout(sensor=1, start=3.0),
    }
    options = {"record": ["controller.fault_probability"], "metrics": [cosim.LoopFigures()], **options}
    return cosim.Campaign(loop, duration=5.0, seeds=2, grid={"fault": {"first": first(), **kinds}}, **options)


def test_each_point_has_its_own_faults_and_they_are_those_of_the_table():
    """The faults are called freeze_0, injection_1 and dropout_1: no name is recorded that exists at all points."""
    result = campaign().run()
    data, table = result.dataset, result.table
    for i in range(2):
        share = data[FAULTY].to_numpy()[:, :, i].mean(axis=1)
        np.testing.assert_allclose(share, table[f"sensors.{i}.fault_share"])
        np.testing.assert_allclose(data[MISSING].to_numpy()[:, :, i].mean(axis=1), table[f"sensors.{i}.missing_share"])
    assert (data[FAULTY].to_numpy().any(axis=1).astype(int).tolist()) == 2 * [[1, 0]] + 4 * [[0, 1]]
    assert data[MISSING].to_numpy().any(axis=(1, 2)).tolist() == 4 * [False] + 2 * [True]


@pytest.mark.parametrize("metrics", [[], [cosim.LoopFigures()]])
def test_every_step_that_is_kept_has_the_faults_of_its_time(metrics):
    every = campaign().run().dataset[FAULTY]
    some = campaign(decimation=3, metrics=metrics).run().dataset[FAULTY]
    np.testing.assert_array_equal(some, every[:, ::3])


def test_after_the_failure_of_a_run_nothing_is_true():
    def bursting(fault):
        return cosim.varied(loop(fault), {"plant": cosim.StateSpace(control.ss([[1e60]], [[0.1]], [[1.0]], 0, 0.1))})

    made = cosim.Campaign(
        bursting, duration=5.0, grid={"fault": {"early": cosim.Freeze(sensor=0, start=0.2)}}, record=["controller.beta"]
    )
    result = made.run()
    (steps,) = result.table["steps"]
    assert result.table["status"].tolist() == ["failed"]
    flags = result.dataset[FAULTY].to_numpy()[0]
    assert 2 <= steps < 50
    assert flags[: steps + 1, 0].tolist() == [0.0, 0.0] + (steps - 1) * [1.0]
    assert np.isnan(flags[steps + 1 :]).all()


def test_a_point_that_is_no_closed_loop_has_no_truth():
    def sometimes(closed):
        if closed:
            return loop(first())
        diagram = cosim.Diagram(dt=0.1)
        diagram.add(Alone(), "controller")
        return diagram

    made = cosim.Campaign(sometimes, duration=5.0, grid={"closed": [True, False]}, record=["controller.beta"])
    result = made.run()
    assert result.table["reason"].tolist() == ["", ""]
    flags = result.dataset[FAULTY].to_numpy()
    assert flags[0].any()
    assert np.isnan(flags[1]).all()


def test_without_a_score_or_a_loop_no_truth_is_kept():
    assert not {FAULTY, MISSING} & set(campaign(record=["plant.y"]).job.signals)
    assert {FAULTY, MISSING} <= set(campaign(record=["controller.beta"]).job.signals)
    diagram = cosim.Diagram(dt=0.1)
    diagram.add(cosim.Sine(1.0, 1.0), "sine")
    assert set(cosim.Campaign(diagram, duration=1.0, record=["*"]).job.signals) == {"sine.y"}
