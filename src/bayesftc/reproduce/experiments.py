"""The list of the experiments.

To add one you must:

1. put its settings, each with its reason, into ``settings.py``, and what the paper prints into ``paper.py``;
2. write ``run(*, seed, jobs, runs, beyond, progress)``, which returns a dictionary of plain data with the keys ``settings``
   (with the ``seed``, which is printed above the tables) and ``paper`` among others: what the JSON file holds. ``runs`` makes
   the experiment smaller, for a quick look (None: the settings' size); ``beyond=False`` leaves out what is not in the paper.
   The same seed must give the same bits for any number of jobs: `_ensemble` has what that takes;
3. write ``show(report)``, which yields what is printed (strings and tables), and for each figure a function that returns it
   as a matplotlib figure, or None where the report has nothing to draw; all know the report alone. The figures' names are
   those of their files: a run removes those that an earlier one has left in its folder, and no other file;
4. name it in `EXPERIMENTS`, and in the package's ``__init__.py`` twice: in ``__all__``, and for type checkers among the imports
   below ``TYPE_CHECKING``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bayesftc.reproduce import (
    _arm,
    _arm_figures,
    _arm_tables,
    _beliefs,
    _beliefs_tables,
    _bound,
    _bound_figures,
    _bound_tables,
    _detection,
    _detection_figures,
    _detection_tables,
    _family,
    _family_figures,
    _family_tables,
    _models,
    _models_figures,
    _models_tables,
    _probabilities,
    _probabilities_figures,
    _probabilities_tables,
    _tracking,
    _tracking_figures,
    _tracking_tables,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

Report = dict[str, Any]


@dataclass(frozen=True)
class Experiment:
    """An experiment, the paper's or beyond it: what it computes, prints and draws."""

    name: str
    run: Callable[..., Report]
    show: Callable[[Report], Iterable[RenderableType]]
    figures: Mapping[str, Callable[[Report], Figure | None]]
    beyond: bool = False
    """Whether it is not in the paper: then ``all --paper-only`` leaves it out."""
    filtered: bool = False
    """Whether its `run` also takes ``cases`` and ``learners``, names or patterns of those that are to run, and ``unseen``."""


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
