"""What a diagnosis finds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesftc.cosim.base.html import table
from bayesftc.cosim.base.numbers import short


@dataclass(frozen=True)
class ModelFinding:
    """A way in which a model is wrong.

    Attributes
    ----------
    kind : str
        ``"sign"`` or ``"gain"`` of a column of B, ``"gains"`` of all its columns, each by its own factor, ``"dt"`` (the plant is
        faster or slower), ``"late"`` (a delay or a lag of the control), ``"early"`` (the model's delays are too long),
        ``"limit"`` (of the control), ``"rate"`` (a limit of its change), ``"exchanged"`` (two controls, one in the place of the
        other), ``"deadband"`` (of the actuator: stiction or play, or a dead zone about zero),
        ``"nonlinear"`` (far from the point of linearisation; never in a closed loop with a linear plant), ``"dynamics"``
        (another A), ``"load"`` (a constant load), ``"onset"`` (a load or an offset of the actuator that begins
        during the run), ``"loss"`` (a control of which the effect changes during the run), ``"offset"``
        (all sensors of a quantity have a constant offset), ``"late_sensors"`` (all of a quantity are late), ``"noise"``
        (more process noise than in the model, or a load that changes all the time; only if another kind would be reported
        without it, or `model_suspect` was raised),
        ``"sensors"`` (one or several sensors failed: without the samples for which the controller blames them there is no
        evidence against the model; the explanation for healthy sensors is among the `others`),
        ``"start"`` (the belief starts where the samples exclude it),
        ``"lost"`` (the plant has left for good, without evidence against the model before), ``"unknown"``.
    sentence : str
        What is wrong, and what to do.
    values : tuple of float
        ``sign`` and ``gain``: the control's effect relative to the model's, and its number; ``gains``: that of each control,
        and then the standard deviation of each; ``dt``: the plant's speed relative to the model's; ``late``: seconds, 1 for a
        lag, and of one of several controls its number; ``early``: seconds, and that number; ``limit``: low, high, and the
        number of the control; ``rate``: the limit in a second, and that number; ``exchanged``: the numbers of the two controls;
        ``deadband``: its whole width in the unit of the control, the control's number, and 1 if it is about where the actuator
        stands, 0 if about zero; ``load``: a value for each control, in its unit; ``onset``: begin and end in seconds after the
        first sample (infinity: to the last one), then as ``load``; the same of a second load, if there is one; ``loss``: begin,
        end, effect relative to the model's, number of the control, and for a stuck actuator (effect near 0) the control at
        which it is stuck; ``offset``: a value for each sensor, in its unit, 0 for those without; ``late_sensors``: seconds for
        each sensor; ``noise``: number of the state (-1 for each of the plant's; that of a disturbance is a load on a control)
        and standard deviation in a sample; or -2 and a factor of the standard deviations of the model's noise; or, for a load
        that the model does not have: the number that its disturbance would get, the standard deviation of its change in a
        sample, its mean (0 if there is no evidence for a mean), and the share of the model's process covariance that remains
        beside the load; ``start``: the belief, the first sample, and the sensor; else empty.
    evidence : float
        Log-likelihood ratio to the unchanged model. Each set of sensors that can observe the plant on its own has one; this is
        the least of those that are for or against the explanation.
    others : tuple of str
        Kinds that explain the run nearly as well; the sentence has them as well.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesftc import controllers
    >>> rng = np.random.default_rng(0)
    >>> model = controllers.LinearModel([[0.9]], [[0.1]], [[1.0], [1.0]], 1e-4, 0.01, dt=0.1)
    >>> u, x = np.repeat(rng.choice([-5.0, 5.0], (40, 1)), 5, axis=0), np.zeros((200, 1))
    >>> for k in range(2, 199):
    ...     x[k + 1] = 0.9 * x[k] + 0.1 * u[k - 2]  # two samples late
    >>> finding = controllers.diagnose_recording(model, x + 0.1 * rng.standard_normal((200, 2)), u)
    >>> finding.kind, finding.values[0]  # the control is late, by 0.2 s
    ('late', 0.2)
    """

    kind: str
    sentence: str
    values: tuple[float, ...] = ()
    evidence: float = float("nan")
    others: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return short(self)

    def __str__(self) -> str:
        return self.sentence

    def _repr_html_(self) -> str:
        """Return the sentence and what it is based on, for notebooks."""
        rows: list[tuple[str, object]] = [("kind", self.kind), ("finding", self.sentence)]
        if self.values:
            rows.append(("values", ", ".join(f"{value:.6g}" for value in self.values)))
        if np.isfinite(self.evidence):
            rows.append(("evidence (log-likelihood ratio)", f"{self.evidence:.4g}"))
        if self.others:
            rows.append(("nearly as likely", ", ".join(self.others)))
        return table("The model", rows)


__all__ = ["ModelFinding"]
