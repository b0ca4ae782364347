"""The result of a fit: an FMU with fitted parameters, and how far to trust them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from bayesftc.cosim.base.html import table
from bayesftc.cosim.fitting.uncertainty import Combination
from bayesftc.cosim.fmi.fmu import FMU
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class FittedFMU:
    """An FMU whose parameters are fitted to a recording; the result of `fit`.

    Attributes
    ----------
    plant : FMU
        The FMU with the fitted parameters: a block for diagrams.
    parameters : dict of str to float
        The fitted parameters, in the FMU's units.
    std : dict of str to float
        Their standard errors; NaN for a parameter at a bound of its range.
    undetermined : tuple of str
        Parameters whose standard error is above that of a uniform distribution over their range.
    correlation : ndarray, parameters x parameters
        Correlations of their errors; NaN for a parameter at a bound.
    profile : tuple of Combination
        Directions in which the parameters can change together, the least determined first.
    sensors : dict of str to tuple of str
        The columns of each output.
    offsets : dict of str to float
        What each column constantly reads more than the common reading of the sensors of its output; 0 if no difference is found.
        The fit and its weights are of the samples without it.
    rms, held_out : dict of str to float
        Root-mean-square difference between each column, without its offset, and the run of the FMU, over the samples that count:
        in the fitted part, and in the held-out part (NaN without one).
    sentences : tuple of str
        What the result lacks, as sentences; empty if nothing.
    time : ndarray, steps
        Seconds, as in the recording.
    measured, weights : ndarray, steps x columns
        Samples (NaN where there is none), and how much each counts, from 0 to 1.
    fitted : ndarray, steps x outputs
        The outputs of the FMU.
    split : int
        The first step of the held-out part.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from bayesftc import cosim, fmus
    >>> time = 0.1 * np.arange(300)
    >>> v = 20.0 * np.exp(-0.05 * time) + 0.1 * np.random.default_rng(0).standard_normal(300)
    >>> table = pd.DataFrame({"time": time, "v": v})
    >>> fitted = cosim.fit(fmus.path("CruiseControl"), table, {"m": (50.0, 300.0), "v0": (10.0, 30.0)}, outputs="v")
    >>> {name: f"{value:.1f} +- {fitted.std[name]:.2f}" for name, value in fitted.parameters.items()}
    {'m': '100.0 +- 0.17', 'v0': '20.0 +- 0.02'}
    """

    plant: FMU
    parameters: dict[str, float]
    std: dict[str, float]
    undetermined: tuple[str, ...]
    correlation: Floats
    profile: tuple[Combination, ...]
    sensors: Mapping[str, tuple[str, ...]]
    offsets: dict[str, float]
    rms: dict[str, float]
    held_out: dict[str, float]
    sentences: tuple[str, ...]
    time: Floats = field(repr=False)
    measured: Floats = field(repr=False)
    weights: Floats = field(repr=False)
    fitted: Floats = field(repr=False)
    split: int = field(repr=False)

    def __repr__(self) -> str:
        fitted = ", ".join(f"{name}={value:.4g} {self.units[name]}".rstrip() for name, value in self.parameters.items())
        return f"FittedFMU({fitted})"

    def _repr_html_(self) -> str:
        """Return the fitted parameters and the errors of the outputs, for notebooks."""
        units = self.units
        rows = [
            (
                f"{name}{' (not determined)' * (name in self.undetermined)}",
                *(f"{number:.6g} {units[name]}".rstrip() for number in (value, float(f"{self.std[name]:.2g}"))),
            )
            for name, value in self.parameters.items()
        ]
        errors = [
            (column, f"{rms:.3g}", "" if np.isnan(self.held_out[column]) else f"{self.held_out[column]:.3g}")
            for column, rms in self.rms.items()
        ]
        return "\n".join(
            [
                table("Fitted parameters", rows, ("parameter", "value", "standard error")),
                table("Errors (root mean square)", errors, ("column", "fitted part", "held-out part")),
                *(f"<p>{escape(sentence)}</p>" for sentence in self.sentences),
            ]
        )

    def __str__(self) -> str:
        units = self.units
        lines = [
            f"{name} = {value:.6g} {units[name]}".rstrip()
            + (" (not determined)" if name in self.undetermined else f" (standard error {self.std[name]:.2g})")
            for name, value in self.parameters.items()
        ]
        for column, rms in self.rms.items():
            rest = "" if np.isnan(self.held_out[column]) else f", held out {self.held_out[column]:.3g}"
            lines.append(f"{column}: rms error {rms:.3g}{rest}.")
        return "\n".join([*lines, *self.sentences])

    @property
    def units(self) -> dict[str, str]:
        """Units of the parameters and outputs; empty texts where the FMU states none."""
        stated = {variable.name: variable.unit or "" for variable in self.plant.description.variables}
        return {name: stated.get(name, "") for name in (*self.parameters, *self.sensors)}

    def plot(self) -> Figure:
        """Return a figure: for each output samples and fit, and below their differences."""
        from bayesftc.cosim.fitting.figure import plot_fit
        from bayesftc.cosim.judging.figures.panels import shown_figure

        return plot_fit(self, shown_figure())
