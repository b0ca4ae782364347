"""What a run shows of faults, by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayesftc.cosim.judging.findings import findings, onset_of_alarm


@pytest.mark.parametrize(
    ("onset", "earlier", "shown"),
    [(None, 8.0, None), (2.0, None, 2.0), (11.0, None, 10.0), (2.0, 8.0, 8.0), (9.0, 8.0, 9.0)],
)
def test_an_onset_is_between_the_earlier_alarm_and_its_own(onset, earlier, shown):
    assert onset_of_alarm(onset, 10.0, earlier) == shown


def test_the_alarms_of_a_run_do_not_begin_inside_the_one_before():
    blamed = np.isin(np.arange(40), [3, 4, 30, 31])
    sensor = SimpleNamespace(
        index=0, unit="m", probability=blamed.astype(float), kind=blamed.astype(int), kinds=("Offset",), sizes=("unit",),
        onset=np.full(40, 2.0), size=np.full(40, 1.0),
    )  # fmt: skip
    run = SimpleNamespace(
        time=np.arange(40.0), sensors=[sensor], actuators=[], process=None, sensor_name=lambda i: f"sensor {i}"
    )
    assert [(found.onset, found.start, found.end) for found in findings(run)] == [(2.0, 3.0, 4.0), (4.0, 30.0, 31.0)]
