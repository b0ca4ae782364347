"""The masses: one FMU that is built here and used twice, and the closed-form solution of the coupled masses."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesftc import cosim
from bayesftc.fmus.build import build_fmu
from bayesftc.fmus.spec import Model, Unit, Variable

Floats = NDArray[np.float64]

_LENGTH, _SPEED, _TIME = Unit("m", m=1), Unit("m/s", m=1, s=-1), Unit("s", s=1)
_STIFFNESS, _DAMPING = Unit("N/m", kg=1, s=-2), Unit("N.s/m", kg=1, s=-1)

SPRUNG_MASS = Model(
    name="SprungMass",
    description="A mass on a spring and a damper whose other end is an input. Integrated by fourth-order Runge-Kutta substeps.",
    source=Path(__file__).with_name("SprungMass.c"),
    variables=(
        Variable("x_other", "input", "Where the other end is, held during a step", _LENGTH),
        Variable("v_other", "input", "How fast the other end moves, held during a step", _SPEED),
        Variable("x", "output", "Where the mass is", _LENGTH, initial_dependencies=("x0",)),
        Variable("v", "output", "How fast the mass moves", _SPEED, initial_dependencies=("v0",)),
        Variable("m", "parameter", "Mass", Unit("kg", kg=1), start=1.0),
        Variable("k", "parameter", "Stiffness of the spring", _STIFFNESS, start=100.0),
        Variable("c", "parameter", "Damping of the damper", _DAMPING),
        Variable("x0", "parameter", "x at the start time", _LENGTH),
        Variable("v0", "parameter", "v at the start time", _SPEED),
        Variable("max_substep", "parameter", "Longest substep of the integration, positive", _TIME, start=2e-4),
    ),
    step=1e-3,
)


@cache
def sprung_mass(fmi: str = "2.0") -> Path:
    """Return the FMU, built for this machine; it is deleted when the process ends."""
    folder = _folder()
    return build_fmu(SPRUNG_MASS, Path(folder.name), fmi=fmi)


@cache
def _folder() -> Any:
    return tempfile.TemporaryDirectory(prefix="coupled-masses-")


@dataclass(frozen=True)
class Masses:
    """Two masses on one spring and damper, of unstretched length zero.

    Parameters
    ----------
    m : tuple of float
        Masses in kg.
    k, c : float
        Stiffness in N/m, damping in N.s/m.
    x0, v0 : tuple of float
        Initial positions in m and speeds in m/s.
    """

    m: tuple[float, float] = (1.0, 2.0)
    k: float = 100.0
    c: float = 0.0
    x0: tuple[float, float] = (1.0, 0.0)
    v0: tuple[float, float] = (0.0, 0.5)

    @property
    def period(self) -> float:
        """The period of the undamped oscillation in seconds."""
        return float(2 * np.pi * np.sqrt(self._reduced / self.k))

    @property
    def _reduced(self) -> float:
        return self.m[0] * self.m[1] / (self.m[0] + self.m[1])

    def exact(self, t: Floats) -> Floats:
        """Return x1, x2, v1, v2 over time: the centre of mass has a constant speed, the distance oscillates (underdamped)."""
        (m1, m2), whole = self.m, self.m[0] + self.m[1]
        decay = self.c / (2 * self._reduced)
        omega = np.sqrt(self.k / self._reduced - decay**2)
        r0, w0 = self.x0[0] - self.x0[1], self.v0[0] - self.v0[1]
        swing, turn = r0, (w0 + decay * r0) / omega
        shape = np.exp(-decay * t)
        r = shape * (swing * np.cos(omega * t) + turn * np.sin(omega * t))
        w = -decay * r + shape * omega * (turn * np.cos(omega * t) - swing * np.sin(omega * t))
        speed = (m1 * self.v0[0] + m2 * self.v0[1]) / whole
        centre = (m1 * self.x0[0] + m2 * self.x0[1]) / whole + speed * t
        return np.array(
            [centre + m2 / whole * r, centre - m1 / whole * r, speed + m2 / whole * w, speed - m1 / whole * w]
        )

    def energy(self, x1: Floats, x2: Floats, v1: Floats, v2: Floats) -> Floats:
        """Return the energy in J of the motion relative to the centre of mass and of the spring."""
        return 0.5 * self._reduced * (v1 - v2) ** 2 + 0.5 * self.k * (x1 - x2) ** 2

    def together(self, v1: Floats, v2: Floats) -> Floats:
        """Return the speed of the centre of mass in m/s, which no force changes."""
        return (self.m[0] * v1 + self.m[1] * v2) / (self.m[0] + self.m[1])

    def diagram(self, dt: float | str, fmi: tuple[str, str] = ("2.0", "2.0")) -> cosim.Diagram:
        """Return the diagram of the two FMUs, not built yet."""
        diagram = cosim.Diagram(dt)
        both = [
            diagram.add(
                cosim.FMU(
                    sprung_mass(version),
                    parameters={"m": self.m[i], "k": self.k, "c": self.c, "x0": self.x0[i], "v0": self.v0[i]},
                ),
                name,
            )
            for i, (name, version) in enumerate(zip(("one", "two"), fmi, strict=True))
        ]
        for here, there in (both, both[::-1]):
            diagram.connect(here["x"], there["x_other"])
            diagram.connect(here["v"], there["v_other"])
        return diagram

    def error(self, result: cosim.Result) -> float:
        """Return the largest error of a position in m."""
        exact = self.exact(result.time)
        return float(max(np.abs(result["one.x"] - exact[0]).max(), np.abs(result["two.x"] - exact[1]).max()))
