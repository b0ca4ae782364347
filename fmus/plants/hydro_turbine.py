"""The description of the water turbine behind a penstock, on which a goal for the next step alone fails."""

from pathlib import Path

from bayesftc.fmus.spec import Model, Unit, Variable

__all__ = ["HYDRO_TURBINE"]

_S = Unit("s", s=1)

_SUBSTEP = Variable("max_substep", "parameter", "Longest substep of the integration, positive", _S, start=1e-3)

HYDRO_TURBINE = Model(
    name="HydroTurbine",
    description="A water turbine at the end of a penstock, per unit: opening the gate first lowers the power. It starts in "
    "steady state.",
    source=Path(__file__).with_name("HydroTurbine.c"),
    variables=(
        Variable("command", "input", "Where the gate is to go, above zero, held during a step", start=0.6),
        Variable("head", "input", "Head of the water, held during a step", start=1.0),
        Variable("power", "output", "Power at the shaft", initial_dependencies=("gate_0", "head")),
        Variable("gate", "output", "Opening of the gate", initial_dependencies=("gate_0",)),
        Variable("flow", "output", "Flow of the water", initial_dependencies=("gate_0", "head")),
        Variable("Tw", "parameter", "Time in which the head brings the water to its rated flow", _S, start=1.0),
        Variable("Tg", "parameter", "Time constant of the gate", _S, start=0.2),
        Variable("gate_0", "parameter", "Opening of the gate at the start time, above zero", start=0.6),
        _SUBSTEP,
    ),
    step=0.05,
    libraries=("m",),
)
