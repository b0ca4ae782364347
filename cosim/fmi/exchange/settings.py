"""The integrator of a model exchange FMU, and its tolerances."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.base.numbers import real
from bayesftc.cosim.errors import ModelError

if TYPE_CHECKING:
    from bayesftc.cosim.fmi.reading.archive import Archive
    from bayesftc.cosim.fmi.reading.description import FMUDescription

METHODS = ("RK23", "RK45", "DOP853", "Radau", "BDF", "LSODA")
"""The methods of ``scipy.integrate.solve_ivp``."""

DEFAULT_TOLERANCE = 1e-6

RESTARTED = 0.01
"""Factor on the tolerances for CVODE. It restarts with order one at each communication point, where its errors per step are as
large as allowed, and of one sign. With this factor, a run is about as accurate as one without restarts."""

INTERNAL_STEPS = 100_000
"""Steps that an integrator may take from one communication point, or event, to the next."""


def checked_settings(
    archive: Archive, description: FMUDescription, exchange: bool, solver: Any, rtol: Any, atol: Any
) -> dict[str, Any]:
    """Return the settings ``solver``, ``rtol`` and ``atol`` with their defaults filled in.

    For co-simulation ``solver`` and ``atol`` are None; ``rtol`` is given, or from the FMU's default experiment, or None.

    Raises
    ------
    ModelError
        If one of them is not valid, or a solver or absolute tolerance is given for co-simulation.
    """
    given = {name: value for name, value in (("solver", solver), ("atol", atol)) if value is not None}
    if given and not exchange:
        raise ModelError(
            f"FMU has {' and '.join(f'{n}={v!r}' for n, v in given.items())}, but {archive.path.name} is used for "
            "co-simulation and brings its own solver. Leave it out, or give kind='model exchange'."
        )
    solvers = ["cvode", "rk45", *(f"scipy:{method}" for method in METHODS)]
    chosen = ("cvode" if solver is None else solver) if exchange else None
    if exchange and chosen not in solvers:
        raise ModelError(f"FMU has solver={solver!r}; it must be one of {', '.join(solvers)}.")
    for name, value in (("rtol", rtol), ("atol", atol)):
        if value is not None and not 0 < real(value) < math.inf:
            raise ModelError(f"FMU has {name}={value!r}; it must be a positive number, as 1e-6.")
    if rtol is not None and description.fmi_major == 1 and not exchange:
        raise ModelError(
            f"FMU has rtol={rtol!r}, but {archive.path.name} is of FMI 1.0, whose co-simulation has no tolerance. Leave it out, "
            "or export the model as FMI 2.0 or 3.0."
        )
    default = description.default_experiment.get("tolerance", 0.0)
    if rtol is None:
        applies = exchange or description.fmi_major > 1
        rtol = default if applies and 0 < default < 1 else DEFAULT_TOLERANCE if exchange else None
    if rtol is not None and not rtol < 1:
        raise ModelError(f"FMU has rtol={rtol!r}; it is a relative tolerance and must be below 1.")
    return {
        "solver": chosen,
        "rtol": None if rtol is None else float(rtol),
        "atol": None if atol is None else float(atol),
    }
