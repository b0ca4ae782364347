"""Calibration of fault probabilities: of the samples with a fault probability of 30 %, 30 % should be faulty."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from bayesftc.cosim.base.numbers import short
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.judging.metrics import NAN, without_nan
from bayesftc.cosim.types import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Reliability:
    """The agreement of probabilities with the truth; made by `reliability`.

    Attributes
    ----------
    brier : float
        Mean squared difference between probability and truth (0 or 1).
    brier_of_constant : float
        Brier score of a constant probability, the share of faulty samples: a calibrated detector without information.
    calibration_error : float
        Expected calibration error: mean over the samples of the gap between `predicted` and `observed` in their bins.
    samples : ndarray of shape (bins,)
        Number of samples in each bin.
    predicted, observed : ndarray of shape (bins,)
        Mean probability in each bin, and share of its samples that were faulty; NaN for an empty bin.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import cosim
    >>> rng = np.random.default_rng(0)
    >>> probability = rng.random(10000)
    >>> result = cosim.reliability(probability**2, rng.random(10000) < probability, bins=4)  # too low
    >>> result.predicted.round(2).tolist()
    [0.02, 0.15, 0.4, 0.77]
    >>> result.observed.round(2).tolist()
    [0.13, 0.37, 0.63, 0.86]
    >>> round(result.calibration_error, 2)
    0.16
    """

    brier: float
    brier_of_constant: float
    calibration_error: float
    samples: Floats = field(repr=False)
    predicted: Floats = field(repr=False)
    observed: Floats = field(repr=False)

    def __repr__(self) -> str:
        return short(self)

    def between(self, low: float = 0.1, high: float = 0.9) -> tuple[float, float]:
        """Return how many samples are in bins whose mean probability lies between two numbers, and their calibration error.

        Where nearly all probabilities are near zero or one, the calibration error of all samples is theirs. Whoever acts on a
        probability of 50 % needs that of the others. Bins of equal width tell them apart.

        Parameters
        ----------
        low, high : float
            The probabilities between which the bins lie.

        Returns
        -------
        samples, error : float
            Number of the samples, and their calibration error; NaN without a sample.

        Examples
        --------
        >>> import numpy as np
        >>> from bayesftc import cosim
        >>> probability = np.repeat([0.01, 0.5, 0.99], [900, 20, 80])
        >>> faulty = np.arange(1000) >= 915
        >>> result = cosim.reliability(probability, faulty, equal="widths")
        >>> [round(number, 3) for number in (result.calibration_error, *result.between())]
        [0.015, 20.0, 0.25]
        """
        inner = (self.samples > 0) & (low < self.predicted) & (self.predicted < high)
        samples = float(self.samples[inner].sum())
        gaps = np.abs(self.predicted - self.observed)[inner] @ self.samples[inner]
        return samples, float(gaps) / samples if samples else NAN

    def label(self) -> str:
        """Return the calibration error in words for a figure, beside that of the bins from 0.1 to 0.9."""
        samples, error = self.between()
        inner = (
            f";\n{error:.3f} in bins from 0.1 to 0.9 ({samples:.0f} of {self.samples.sum():.0f} samples)"
            if samples
            else ""
        )
        return f"calibration error {self.calibration_error:.3f}{inner}"

    def plot(self, title: str | None = None) -> Figure:
        """Return the reliability diagram: share of faulty samples over mean probability, and the samples of each bin.

        Bins of equal width (``equal="widths"`` of `reliability`) are usual for it.

        Parameters
        ----------
        title : str, optional
            Title of the figure.
        """
        from bayesftc.cosim.judging.figures.panels import shown_figure
        from bayesftc.cosim.judging.figures.reliability import plot_reliability

        return plot_reliability(self, shown_figure(), title)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for a JSON file; NaN becomes None."""
        numbers = ("brier", "brier_of_constant", "calibration_error")
        arrays = ("samples", "predicted", "observed")
        plain: dict[str, Any] = without_nan(
            {**{n: getattr(self, n) for n in numbers}, **{n: getattr(self, n).tolist() for n in arrays}}
        )
        return plain


def reliability(
    probability: ArrayLike, faulty: ArrayLike, *, bins: int = 10, equal: Literal["counts", "widths"] = "counts"
) -> Reliability:
    """Return the agreement of probabilities with the truth: reliability diagram, Brier score, expected calibration error.

    Parameters
    ----------
    probability : array_like
        Fault probabilities, of any shape; samples without one (NaN) are left out.
    faulty : array_like of bool of the same shape
        The truth.
    bins : int
        Number of bins.
    equal : str
        ``"counts"``: all bins have equally many samples (Nguyen and O'Connor 2015). Rare high probabilities then share a bin,
        and the error is not only that of the many healthy samples. ``"widths"``: all bins have the same width (Guo et al.
        2017), as is usual for diagrams.

    Returns
    -------
    Reliability
        The bins, the Brier score and the calibration error.

    Raises
    ------
    ModelError
        If shapes do not agree, a probability is not in [0, 1], there are fewer samples than bins, or `equal` is unknown.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import cosim
    >>> rng = np.random.default_rng(0)
    >>> probability = rng.random(10000)
    >>> result = cosim.reliability(probability, rng.random(10000) < probability)  # calibrated probabilities
    >>> round(result.brier, 2), round(result.brier_of_constant, 2), result.calibration_error < 0.02
    (0.17, 0.25, True)
    """
    p, truth = np.asarray(probability, dtype=np.float64), np.asarray(faulty, dtype=np.bool_)
    if p.shape != truth.shape:
        raise ModelError(
            f"reliability has probabilities of shape {p.shape} and a truth of shape {truth.shape}; give equal shapes."
        )
    valid = ~np.isnan(p)
    p, happened = p[valid], truth[valid].astype(np.float64)
    return of_bins(p, happened, bins_of(p, bins, equal), bins)


def of_bins(p: Floats, happened: Floats, place: np.ndarray[Any, np.dtype[np.intp]], bins: int) -> Reliability:
    """Return the agreement of probabilities with the truth (0 or 1), given the number of the bin of each probability."""
    samples, predicted, observed = (np.bincount(place, weights, bins) for weights in (None, p, happened))
    with np.errstate(invalid="ignore"):
        shown = [np.where(samples > 0, total / samples, NAN) for total in (predicted, observed)]
    share = float(happened.mean())
    return Reliability(
        brier=float(np.mean((p - happened) ** 2)),
        brier_of_constant=share * (1.0 - share),
        calibration_error=float(np.abs(predicted - observed).sum() / len(p)),
        samples=samples.astype(np.float64),
        predicted=shown[0],
        observed=shown[1],
    )


def bins_of(probability: Floats, bins: int, equal: str) -> np.ndarray[Any, np.dtype[np.intp]]:
    """Return the number of the bin of each probability; `reliability` describes arguments and errors."""
    if isinstance(bins, bool) or not isinstance(bins, int) or not 1 <= bins <= len(probability):
        raise ModelError(
            f"reliability has bins={bins!r} for {len(probability)} samples; give a whole number from 1 to the number of samples."
        )
    if probability.min() < 0 or probability.max() > 1:
        raise ModelError(
            f"reliability has probabilities from {probability.min():g} to {probability.max():g}; they must be between 0 and 1."
        )
    if equal == "counts":
        order = np.argsort(probability, kind="stable")
        place = np.empty(len(probability), dtype=np.intp)
        place[order] = np.repeat(np.arange(bins), [len(part) for part in np.array_split(order, bins)])
        return place
    if equal == "widths":
        return np.minimum((probability * bins).astype(np.intp), bins - 1)
    raise ModelError(f"reliability has equal={equal!r}; it must be 'counts' or 'widths'.")
