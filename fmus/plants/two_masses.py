"""The description of the two masses on a rail, on which a goal for the next step alone fails."""

from pathlib import Path

from bayesftc.fmus.spec import Model, Unit, Variable

__all__ = ["TWO_MASSES"]

_M = Unit("m", m=1)
_M_PER_S = Unit("m/s", m=1, s=-1)
_N = Unit("N", kg=1, m=1, s=-2)
_KG = Unit("kg", kg=1)
_S = Unit("s", s=1)

_SUBSTEP = Variable("max_substep", "parameter", "Longest substep of the integration, positive", _S, start=1e-3)

TWO_MASSES = Model(
    name="TwoMasses",
    description="Two masses on a rail with a spring and a damper between them, and a force on each.",
    source=Path(__file__).with_name("TwoMasses.c"),
    variables=(
        Variable("force1", "input", "Force on the first mass, held during a step", _N),
        Variable("force2", "input", "Force on the second mass, held during a step", _N),
        Variable("x1", "output", "Place of the first mass", _M, initial_dependencies=("x1_0",)),
        Variable("x2", "output", "Place of the second mass", _M, initial_dependencies=("x2_0",)),
        Variable("v1", "output", "Velocity of the first mass", _M_PER_S),
        Variable("v2", "output", "Velocity of the second mass", _M_PER_S),
        Variable("m1", "parameter", "First mass", _KG, start=1.0),
        Variable("m2", "parameter", "Second mass", _KG, start=1.0),
        Variable("k", "parameter", "Stiffness of the spring", Unit("N/m", kg=1, s=-2), start=100.0),
        Variable("d", "parameter", "Damping between the masses", Unit("N.s/m", kg=1, s=-1), start=1.0),
        Variable("x1_0", "parameter", "Place of the first mass at the start time", _M),
        Variable("x2_0", "parameter", "Place of the second mass at the start time", _M),
        _SUBSTEP,
    ),
    step=0.02,
    libraries=("m",),
)
