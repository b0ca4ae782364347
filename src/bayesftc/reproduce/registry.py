"""The list of the experiments.

To add an experiment:

1. Put its settings, each with its reason, into ``settings.py``, and the paper's numbers into ``paper.py``.
2. Write ``run(ensemble, settings, ...)``, decorated by `experiment` of ``shared/runner.py``, which describes its arguments. It
   returns a dictionary of plain data, the content of the JSON file. The same seed must give the same bits for any number of
   jobs; use `Ensemble` for that.
3. Write ``show(report)``, which yields the printed output: strings, and tables from `listed` and `crossed` of
   ``shared/tables.py``. For each figure write a function that returns a matplotlib figure, or None if the report has nothing to
   draw. All of them use only the report. A figure's name is that of its file: a run removes only old files of these names.
4. Add it to `EXPERIMENTS`, and twice to the package's ``__init__.py``: to ``__all__``, and for type checkers to the imports
   below ``TYPE_CHECKING``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bayesftc.reproduce.experiments.arm import figures as _arm_figures, run as _arm, tables as _arm_tables
from bayesftc.reproduce.experiments.beliefs import run as _beliefs, tables as _beliefs_tables
from bayesftc.reproduce.experiments.bound import figures as _bound_figures, run as _bound, tables as _bound_tables
from bayesftc.reproduce.experiments.detection import (
    figures as _detection_figures,
    run as _detection,
    tables as _detection_tables,
)
from bayesftc.reproduce.experiments.family import figures as _family_figures, run as _family, tables as _family_tables
from bayesftc.reproduce.experiments.models import figures as _models_figures, run as _models, tables as _models_tables
from bayesftc.reproduce.experiments.probabilities import (
    figures as _probabilities_figures,
    run as _probabilities,
    tables as _probabilities_tables,
)
from bayesftc.reproduce.experiments.tracking import (
    figures as _tracking_figures,
    run as _tracking,
    tables as _tracking_tables,
)
from bayesftc.reproduce.shared.runner import Report, Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType


@dataclass(frozen=True)
class Experiment:
    """An experiment, from the paper or beyond it, with its computation, printed output and figures."""

    name: str
    run: Run
    show: Callable[[Report], Iterable[RenderableType]]
    figures: Mapping[str, Callable[[Report], Figure | None]]
    beyond: bool = False
    """Whether it is not in the paper: then ``all --paper-only`` leaves it out."""
    filtered: bool = False
    """Whether its `run` also takes ``cases`` and ``learners``, which are names or patterns, and ``unseen``."""


EXPERIMENTS = {
    e.name: e
    for e in (
        Experiment("arm", _arm.run, _arm_tables.show, _arm_figures.FIGURES),
        Experiment("tracking", _tracking.run, _tracking_tables.show, _tracking_figures.FIGURES),
        Experiment("detection", _detection.run, _detection_tables.show, _detection_figures.FIGURES),
        Experiment("bound", _bound.run, _bound_tables.show, _bound_figures.FIGURES, beyond=True),
        Experiment("models", _models.run, _models_tables.show, _models_figures.FIGURES, beyond=True),
        Experiment("beliefs", _beliefs.run, _beliefs_tables.show, {}, beyond=True),
        Experiment(
            "probabilities",
            _probabilities.run,
            _probabilities_tables.show,
            _probabilities_figures.FIGURES,
            beyond=True,
        ),
        Experiment("family", _family.run, _family_tables.show, _family_figures.FIGURES, beyond=True, filtered=True),
    )
}
"""All experiments by name, in the order in which ``bayesftc reproduce all`` runs them."""
