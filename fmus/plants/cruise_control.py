"""The car under cruise control of the paper's second and third experiments."""

from pathlib import Path

from bayesftc.fmus.spec import Model, Unit, Variable

__all__ = ["CRUISE_CONTROL"]

_NEWTON = Unit("N", kg=1, m=1, s=-2)
_DRAG = Unit("N.s/m", kg=1, s=-1)
_SPEED = Unit("m/s", m=1, s=-1)
_MASS = Unit("kg", kg=1)

CRUISE_CONTROL = Model(
    name="CruiseControl",
    description="A car on a level road, as the discrete map v <- (1 - b/m*h)*v + h/m*force + disturbance for each "
    "communication step of size h. Deterministic: process noise enters through the input 'disturbance'.",
    source=Path(__file__).with_name("CruiseControl.c"),
    variables=(
        Variable("force", "input", "Driving force, held during a step", _NEWTON),
        Variable("disturbance", "input", "Velocity added once per communication step, whatever its size", _SPEED),
        Variable("v", "output", "Velocity", _SPEED, initial_dependencies=("v0",)),
        Variable("b", "parameter", "Drag coefficient", _DRAG, start=5.0),
        Variable("m", "parameter", "Mass of the car", _MASS, start=100.0),
        Variable("v0", "parameter", "Velocity at the start time", _SPEED),
    ),
    step=0.02,
)
