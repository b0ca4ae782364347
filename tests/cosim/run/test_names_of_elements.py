"""Elements of signals by name, and python-control's names of signals without labels."""

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim


def loop(n):
    plant = control.ss(-0.2 * np.eye(n), 0.1 * np.eye(n), np.eye(n), 0)
    of_plant = {"measured": [f"y[{i}]" for i in range(n)]}, [f"u[{i}]" for i in range(n)]
    controller = controllers.design(
        plant, **of_plant[0], actuated=of_plant[1], sensors=n, acceptable_error=0.1, acceptable_control=1.0, dt=0.1
    )
    return cosim.closed_loop(plant, controller, control=of_plant[1], **of_plant[0], reference=[1.0] * n)


@pytest.fixture(scope="module", params=[1, 2])
def made(request):
    made = loop(request.param)
    return made, made.simulate(1.0, seed=1, record=["*", "plant.*"], engine="interpreted")


def test_an_element_is_a_column_of_its_signal(made):
    run = made[1]
    for name in ("controller.u", "sensors.y", "controller.x_hat"):
        for i in range(run[name].shape[1]):
            np.testing.assert_array_equal(run[f"{name}[{i}]"], run[name][:, i])
    np.testing.assert_array_equal(run["controller.P[0,0]"], run["controller.P"][:, 0, 0])
    assert run.to_control("controller.u[0]").output_labels == ["controller.u[0]"]


def test_default_labels_of_python_control_name_the_signals(made):
    loop, run = made
    plain = {1: ("y", "u"), 2: ("y0", "u0")}[run["sensors.y"].shape[1]]
    np.testing.assert_array_equal(run["plant.y[0]"], run[f"plant.{plain[0]}"])
    for name in ("u[0]", "plant.u[0]", f"plant.{plain[1]}"):
        assert loop.margins(at=name) == loop.margins(at=plain[1])
    assert loop.step_info("y[0]") == loop.step_info(plain[0])


@pytest.mark.parametrize(
    "name", ["controller.u[7]", "controller.P[0]", "plant.y[7]", "plant.y[x]", "u[0]", "controller.u[", ""]
)
def test_other_names_are_refused(made, name):
    loop, run = made
    assert name not in run
    with pytest.raises(cosim.UnknownNameError, match="no signal"):
        run[name]
    with pytest.raises(cosim.UnknownNameError, match=r"The loop has no control 'u\[7\]'; known names: u"):
        loop.margins(at="u[7]")
