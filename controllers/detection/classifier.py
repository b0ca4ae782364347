"""A classifier from residuals to a fault probability, trained on labelled faults (paper, section 4.2)."""

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
    """A classifier was used before its training."""


class FaultClassifier(ClassifierMixin, BaseEstimator):  # type: ignore[misc]
    """Learns the probability of a fault from labelled residuals: a scikit-learn classifier that becomes a block.

    Rows are samples of one sensor, columns its residuals, labels whether it was faulty; the larger of two labels means faulty.
    Samples of all sensors are pooled. `residual_features` makes the rows.

    Parameters
    ----------
    estimator : classifier, optional
        Any classifier with ``predict_proba``. By default logistic regression without regularisation after a standard scaler, so
        that the probability does not depend on the residuals' units. For logarithms of the residuals, use
        ``make_pipeline(FunctionTransformer(np.log), LogisticRegression())``.
    threshold : float
        Decision threshold: `predict` gives faulty where the probability is above it.

    Attributes
    ----------
    classes_ : ndarray of two labels
        The labels of healthy and faulty.
    estimator_ : classifier
        The trained classifier.
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
            Finite numbers; leave missing samples out.
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
                "Only binary classification is supported. The type of the target is multiclass; give labels of two kinds, "
                "healthy and faulty."
            )
        self.classes_, labels = np.unique(y, return_inverse=True)
        if len(self.classes_) < 2:
            raise ModelError(
                f"All {len(labels)} labels are of one class, {self.classes_.tolist()[0]!r}; give samples and labels of healthy "
                "and faulty."
            )
        chosen = _default() if self.estimator is None else clone(self.estimator)
        if not hasattr(chosen, "predict_proba"):
            raise ModelError(
                f"{chosen!r} has no predict_proba; give a classifier that has one, or wrap it in CalibratedClassifierCV."
            )
        self.estimator_ = chosen.fit(rows, labels)
        return self

    def predict_proba(self, X: ArrayLike) -> Floats:
        """Return the probabilities of healthy and faulty.

        Parameters
        ----------
        X : array, shape (samples, residuals)
            Finite numbers.

        Returns
        -------
        ndarray, shape (samples, 2)
        """
        self._check_trained()
        rows = validate_data(self, X, dtype=np.float64, reset=False, ensure_all_finite=False)
        refuse_missing("X", rows)
        return np.asarray(self.estimator_.predict_proba(rows))

    def predict(self, X: ArrayLike) -> np.ndarray[Any, Any]:
        """Return the label of faulty where its probability is above the decision threshold, else the label of healthy.

        Parameters
        ----------
        X : array, shape (samples, residuals)
            Finite numbers.
        """
        faulty = self.predict_proba(X)[:, 1] > self.threshold
        return np.asarray(self.classes_[faulty.astype(int)])

    def block(self, sensors: int, features: str | Sequence[str] = ("beta",)) -> FaultMonitor:
        """Return the trained classifier as a block, for `closed_loop(monitors=...)`, a diagram, or ``online``.

        Logistic regression, also after a logarithm and standard scalers, runs compiled. With any other estimator the diagram runs
        interpreted. The block keeps the training up to now.

        Parameters
        ----------
        sensors : int
            Number of sensors.
        features : str or sequence of str
            The residuals of the training, in the same order, as outputs of the controller: ``"beta"``, ``"innovation"`` (its
            magnitude), or another one with a value for each sensor. A string is one name.

        Raises
        ------
        UntrainedClassifierError
            If the classifier is not trained.
        ModelError
            If the training had another number of residuals.
        """
        self._check_trained()
        names = feature_names(features)
        if len(names) != self.n_features_in_:
            raise ModelError(
                f"The classifier was trained on {self.n_features_in_} residuals, but features={names!r} has {len(names)}; give "
                f"the outputs of the training, in the same order."
            )
        return FaultMonitor(sensors, names, float(self.threshold), self._map() or copy.deepcopy(self.estimator_))

    def calibration(self, prior_rate: float = 1.0) -> Calibration:
        """Return the map for ``GammaPrecision(calibration=...)``, which makes the probability an output of the controller.

        Parameters
        ----------
        prior_rate : float
            The rate b0 of the learner's prior (prior shape times nominal variance) if the training used beta itself; 1 if it
            used beta / b0.

        Raises
        ------
        UntrainedClassifierError
            If the classifier is not trained.
        ModelError
            If the classifier is not a logistic regression on one residual.
        """
        self._check_trained()
        prior_rate = as_number("FaultClassifier.calibration got prior_rate", prior_rate, above=0)
        logistic = self._map()
        if logistic is None or len(logistic.weights) != 1:
            raise ModelError(
                f"Only a logistic regression on beta alone gives a calibration, not {self.estimator_!r} on {self.n_features_in_} "
                "residuals; use block() instead."
            )
        slope = logistic.weights[0] / logistic.scale[0]
        intercept = logistic.intercept - slope * logistic.shift[0]
        if logistic.logarithm:
            return Calibration(slope, intercept + slope * float(np.log(prior_rate)), "log")
        return Calibration(slope * prior_rate, intercept, "linear")

    def _map(self) -> LogisticMap | None:
        """Return the trained estimator as a logistic map, or None if it is not one."""
        steps = (
            [step for _, step in self.estimator_.steps] if isinstance(self.estimator_, Pipeline) else [self.estimator_]
        )
        steps = [step for step in steps if step not in (None, "passthrough")]
        logarithm = bool(steps) and _is_logarithm(steps[0])
        *scalers, last = steps[logarithm:] or [None]
        if type(last) is not LogisticRegression or any(type(s) is not StandardScaler for s in scalers):
            return None
        shift, scale = np.zeros(self.n_features_in_), np.ones(self.n_features_in_)
        for scaler in scalers:  # each scaler computes (x - shift) / scale
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
