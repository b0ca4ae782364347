"""Steady states of plants whose controls have limits, and messages about states that never rest."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy.optimize import root

from bayesftc import cosim
from bayesftc.controllers import design
from bayesftc.cosim.errors import ModelError

G, MASS, LEAST, MOST = 9.81, 1200.0, 5000.0, 16000.0
LIMITS = {"u_min": LEAST, "u_max": MOST}
SETTINGS = {"measured": "h", "actuated": "thrust", "dt": 0.02}


def rocket(*, drag: float = 0.0, burnt: float = 0.0, dt: float = 0.0):
    """Return a rocket of limited thrust, also as samples. If it burns fuel (kg in a second for 1 N), its mass is a state."""

    def rates(t, x, u, params):
        _, v, thrust, mass = x if burnt else (*x, MASS)
        rate = [
            v,
            thrust / mass - G - drag * v * abs(v),
            (min(max(u[0], LEAST), MOST) - thrust) / 0.15,
            -burnt * thrust,
        ]
        return np.array(rate[: len(x)])

    return control.nlsys(
        rates if dt == 0 else lambda t, x, u, params: x + dt * rates(t, x, u, params),
        lambda t, x, u, params: x[:1],
        dt=dt, inputs=["thrust"], outputs=["h"], states=["h", "v", "T", "m"][: 4 if burnt else 3],
    )  # fmt: skip


@pytest.mark.parametrize("drag", [0.0, 0.01])  # with drag it also rests as it falls, but farther from the start
@pytest.mark.parametrize("start", [(100.0, 0.0, MASS * G), (100.0, -5.0, 9000.0)])
def test_the_thrust_that_hovers_is_found_where_none_has_no_effect(drag, start):
    """Between 0 and its lower limit the thrust has no effect, so that a search from 0 cannot move it."""
    plant = rocket(drag=drag)
    hovers = root(lambda z: plant.dynamics(0.0, [start[0], *z[:2]], z[2:]), [*start[1:], 1e4])
    assert hovers.success
    found = design(cosim.StateSpace(plant, initial=start), **SETTINGS, **LIMITS, noise={"thrust": 200.0}).model
    assert [*found.operating_state, *found.operating_control] == pytest.approx(
        [start[0], *hovers.x], rel=1e-6, abs=1e-6
    )


@pytest.mark.parametrize(("dt", "time"), [(0.0, "second"), (0.02, "sample")])
@pytest.mark.parametrize("at", [None, {"thrust": MASS * G}])
def test_a_state_that_never_rests_is_named_with_its_rate(dt, time, at):
    burnt = 1.0 / (220.0 * G)
    plant = cosim.StateSpace(rocket(burnt=burnt, dt=dt), initial=[100.0, 0.0, MASS * G, MASS])
    rate = -burnt * MASS * G * (dt or 1.0)
    with pytest.raises(ModelError, match=rf"at rest, m changes by {rate:.3g} in a {time}\. .*\[known\.plant\]"):
        design(plant, **SETTINGS, **LIMITS, at=at)


def test_a_plant_in_which_two_states_never_rest_is_still_refused():
    tanks = control.nlsys(
        lambda t, x, u, params: [u[0] - np.exp(x[0]), -1.0 - np.exp(x[1]), -2.0 - np.exp(x[2])], lambda t, x, u, params: x[:1],
        inputs=["thrust"], outputs=["h"], states=["a", "b", "c"],
    )  # fmt: skip
    with pytest.raises(ModelError, match=r"with any actuated inputs\. Give other start values"):
        design(tanks, **SETTINGS)


def test_states_without_names_are_counted():
    grows = control.nlsys(
        lambda t, x, u, params: [1.0 + np.exp(x[0])], None, inputs=["thrust"], outputs=["h"], states=1
    )
    with pytest.raises(ModelError, match=r"x\[0\] changes by 2 in a second"):
        design(grows, **SETTINGS)
