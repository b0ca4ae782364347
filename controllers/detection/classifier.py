"""From residuals to a fault probability by a classifier trained on labelled faults (paper, section 4.2)."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, ClassifierMixin, clone
from sklearn.exceptions import NotFittedError
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import FunctionTransformer, StandardScaler
from sklearn.utils.multiclass import check_classification_targets, type_of_target
from sklearn.utils.validation import validate_data

from bayesftc.controllers.detection.monitor import FaultMonitor, LogisticMap
from bayesftc.controllers.detection.residuals import feature_names
from bayesftc.controllers.models.checks import as_number, check_number, refuse_missing
from bayesftc.controllers.precision.rate import Calibration
from bayesftc.cosim.errors import ModelError
from bayesftc.cosim.types import Floats


class UntrainedClassifierError(ModelError, NotFittedError):  # type: ignore[misc]
    """A classifier that is to predict, or to run in a loop, before it has been trained."""


class FaultClassifier(ClassifierMixin, BaseEstimator):  # type: ignore[misc]
    """Learns from labelled residuals how probable a fault is: a scikit-learn classifier that becomes a block.

    Rows are samples of one sensor, columns its residuals, labels whether it was faulty; of two labels the larger means faulty.
    Samples of all sensors are pooled: `residual_features` makes the rows.

    Parameters
    ----------
    estimator : classifier, optional
        Anything with a ``predict_proba``; by default logistic regression without regularisation, behind a standard scaler, so
        that the probability does not depend on the residuals' units. With
        ``make_pipeline(FunctionTransformer(np.log), LogisticRegression())`` it is one of their logarithms.
    threshold : float
        Decision threshold: `predict` says faulty where the probability is above it.

    Attributes
    ----------
    classes_ : ndarray of two labels
        Healthy and faulty.
    estimator_ : classifier
        The trained one.
    n_features_in_ : int
        Number of residuals.

    Examples
    --------
    >>> from bayesftc.controllers import FaultClassifier
    >>> classifier = FaultClassifier(threshold=0.6).fit([[0.1], [0.9], [2.0], [0.4], [3.1]], [0, 1, 1, 0, 1])
    >>> classifier.predict([[0.2], [2.5]]).tolist()
    [0, 1]
    """

    def __init__(self, estimator: Any = None, threshold: float = 0.5):
        self.estimator = estimator
        self.threshold = threshold

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Train the classifier.

        Parameters
        ----------
        X : array, shape (samples, residuals)
            Finite; leave missing samples out.
        y : array, shape (samples,)
            Labels of two kinds, such as False and True.

        Raises
        ------
        ModelError
            If there are labels of one class only or of more than two, samples that are NaN or infinite, a threshold outside
            (0, 1), or an estimator without ``predict_proba``.
        """
        check_number(self, "threshold", above=0, below=1)
        rows, y = validate_data(self, X, y, dtype=np.float64, ensure_all_finite=False)
        refuse_missing("X", rows)
        check_classification_targets(y)
        if type_of_target(y) == "multiclass":
            raise ModelError(
                "Only binary classification is supported. The type of the target is multiclass: give labels of two kinds, "
                "healthy and faulty."
            )
        self.classes_, labels = np.unique(y, return_inverse=True)
        if len(self.classes_) < 2:
            raise ModelError(
                f"All {len(labels)} labels are of one class, {self.classes_.tolist()[0]!r}; a classifier needs healthy and "
                "faulty samples."
            )
        chosen = _default() if self.estimator is None else clone(self.estimator)
        if not hasattr(chosen, "predict_proba"):
            raise ModelError(
                f"{chosen!r} has no predict_proba; choose a classifier that has one, or wrap it in CalibratedClassifierCV."
            )
        self.estimator_ = chosen.fit(rows, labels)
        return self

    def predict_proba(self, X: ArrayLike) -> Floats:
        """Return the probabilities of healthy and faulty.

        Parameters
        ----------
        X : array, shape (samples, residuals)
            Finite.

        Returns
        -------
        ndarray, shape (samples, 2)
        """
        self._check_trained()
        rows = validate_data(self, X, dtype=np.float64, reset=False, ensure_all_finite=False)
        refuse_missing("X", rows)
        return np.asarray(self.estimator_.predict_proba(rows))

    def predict(self, X: ArrayLike) -> np.ndarray[Any, Any]:
        """Return the label of faulty where its probability is above the decision threshold, else that of healthy.

        Parameters
        ----------
        X : array, shape (samples, residuals)
            Finite.
        """
        faulty = self.predict_proba(X)[:, 1] > self.threshold
        return np.asarray(self.classes_[faulty.astype(int)])

    def block(self, sensors: int, features: str | Sequence[str] = ("beta",)) -> FaultMonitor:
        """Return the trained classifier as a block, for `closed_loop(monitors=...)`, a diagram, or ``online``.

        Logistic regression, also behind a logarithm and standard scalers, runs compiled; any other estimator is called back,
        and the diagram runs interpreted. The block keeps what has been learned so far.

        Parameters
        ----------
        sensors : int
            Number of sensors.
        features : str or sequence of str
            The residuals that it was trained on, in the same order, by the controller's outputs: ``"beta"``, ``"innovation"``
            (its magnitude), or any other with a value for each sensor. A string is one of them.

        Raises
        ------
        UntrainedClassifierError
            If it has not been trained.
        ModelError
            If it was trained on another number of residuals.
        """
        self._check_trained()
        names = feature_names(features)
        if len(names) != self.n_features_in_:
            raise ModelError(
                f"The classifier was trained on {self.n_features_in_} residuals, but features={names!r} names "
                f"{len(names)}; name the outputs it was trained on, in the same order."
            )
        return FaultMonitor(sensors, names, float(self.threshold), self._map() or copy.deepcopy(self.estimator_))

    def calibration(self, prior_rate: float = 1.0) -> Calibration:
        """Return the map for ``GammaPrecision(calibration=...)``, so that the controller's own output has the probability.

        Parameters
        ----------
        prior_rate : float
            The rate b0 of the learner's prior (prior shape times nominal variance) if the classifier was trained on beta itself;
            1 if on beta / b0.

        Raises
        ------
        UntrainedClassifierError
            If it has not been trained.
        ModelError
            If it is no logistic regression on one residual.
        """
        self._check_trained()
        prior_rate = as_number("FaultClassifier.calibration got prior_rate", prior_rate, above=0)
        found = self._map()
        if found is None or len(found.weights) != 1:
            raise ModelError(
                f"Only a logistic regression on beta alone is a calibration, not {self.estimator_!r} on {self.n_features_in_} "
                "residuals; run it beside the controller as a block instead."
            )
        slope = found.weights[0] / found.scale[0]
        intercept = found.intercept - slope * found.shift[0]
        if found.logarithm:
            return Calibration(slope, intercept + slope * float(np.log(prior_rate)), "log")
        return Calibration(slope * prior_rate, intercept, "linear")

    def _map(self) -> LogisticMap | None:
        """Return the trained estimator as a logistic map, or None if it is none."""
        steps = (
            [step for _, step in self.estimator_.steps] if isinstance(self.estimator_, Pipeline) else [self.estimator_]
        )
        steps = [step for step in steps if step not in (None, "passthrough")]
        logarithm = bool(steps) and _is_logarithm(steps[0])
        *scalers, last = steps[logarithm:] or [None]
        if type(last) is not LogisticRegression or any(type(s) is not StandardScaler for s in scalers):
            return None
        shift, scale = np.zeros(self.n_features_in_), np.ones(self.n_features_in_)
        for scaler in scalers:  # (x - shift) / scale, and then again so
            if scaler.mean_ is not None and scaler.with_mean:
                shift = shift + scaler.mean_ * scale
            if scaler.scale_ is not None:
                scale = scale * scaler.scale_
        weights, offset, unit = (tuple(map(float, values)) for values in (last.coef_[0], shift, scale))
        return LogisticMap(weights, offset, unit, float(last.intercept_[0]), logarithm)

    def _check_trained(self) -> None:
        if not hasattr(self, "estimator_"):
            raise UntrainedClassifierError(
                "This FaultClassifier has not been trained; call fit(X, y) with labelled residuals first."
            )

    def __sklearn_is_fitted__(self) -> bool:
        return hasattr(self, "estimator_")

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.classifier_tags.multi_class = False
        return tags


def _default() -> Pipeline:
    return make_pipeline(StandardScaler(), LogisticRegression(C=np.inf, max_iter=1000))


def _is_logarithm(step: object) -> bool:
    return isinstance(step, FunctionTransformer) and step.func is np.log and not step.kw_args
