"""Names of what sensors read, from the connections of a loop."""

import control
import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.controllers import LinearModel, LQGController
from bayesftc.cosim.judging.roles import loop_signals


@pytest.mark.parametrize(
    ("matrix", "names_of"),
    [
        ([[1.0, 1.0], [1.0, 0.0]], ["x + w", "x"]),
        ([[-1.0, 0.5], [0.0, -2.0]], ["-x + 0.5 w", "-2 w"]),
        ([[1.0, -0.1], [0.0, 1.0]], ["x - 0.1 w", "w"]),
    ],
)
def test_a_sensor_of_several_signals_is_named_by_what_it_reads(matrix, names_of):
    plant = control.ss(np.diag([0.9, 0.99]), [[0.1], [0.0]], np.eye(2), 0, 0.1, inputs=["u"], outputs=["x", "w"])
    model = LinearModel(np.diag([0.9, 0.99]), [[0.1], [0.0]], matrix, 1e-3, 0.01, dt=0.1)
    controller = LQGController(model, goal_on=[[1.0, 0.0]])
    loop = cosim.closed_loop(
        cosim.StateSpace(plant), controller, control="u", measured=["x", "w"], reference=1.0,
        sensors=cosim.Sensors(2, 0.1, signals=2, matrix=matrix),
    )  # fmt: skip
    run = loop_signals(loop, loop.simulate(2.0))
    assert [quantity.name for quantity in run.quantities] == names_of
    assert run.sensor_name(0) == f"sensor 0 ({names_of[0]})"


def test_a_sensor_of_many_signals_has_its_number_as_name():
    signals = ["x", "a", "b", "c"]
    plant = control.ss(0.9 * np.eye(4), np.eye(4)[:, :1], np.eye(4), 0, 0.1, inputs=["u"], outputs=signals)
    model = LinearModel(0.9 * np.eye(4), np.eye(4)[:, :1], np.ones((1, 4)), 1e-3, 0.01, dt=0.1)
    loop = cosim.closed_loop(
        cosim.StateSpace(plant), LQGController(model), control="u", measured=signals, reference=1.0,
        sensors=cosim.Sensors(1, 0.1, signals=4, matrix=np.ones((1, 4))),
    )  # fmt: skip
    assert [quantity.name for quantity in loop_signals(loop, loop.simulate(1.0)).quantities] == ["sensor 0"]
