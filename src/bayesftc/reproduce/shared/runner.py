"""The common arguments, checks and report of all experiments. Each has its own settings and computes its cells."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from inspect import Parameter, Signature, cleandoc, signature
from typing import Any, Protocol

from bayesftc.reproduce.settings import Repeated, Settings
from bayesftc.reproduce.shared.ensemble import Ensemble, Progress

Report = dict[str, Any]
DEFAULTS = {"seed": 0, "jobs": 1, "runs": None, "beyond": True, "settings": None, "progress": None}
COMMON = """\
Parameters
----------
seed : int
    Seed of all random numbers.
jobs : int
    Number of threads; the results have the same bits for any number.
runs : int, optional
    Repetitions; by default the settings'.
beyond : bool
    Whether to run also what is not in the paper; without effect for an experiment beyond the paper.
settings{others}
    Settings in place of those of `bayesftc.reproduce.settings`: {classes}.
progress : callable, optional
    Called as ``progress(what, done, of)``.{own}

Returns
-------
dict
    The content of the experiment's JSON file.

Raises
------
ModelError
    If the seed, a number or a setting is not valid."""


class Run(Protocol):
    """An experiment as it is called."""

    def __call__(
        self,
        *,
        seed: int = 0,
        jobs: int = 1,
        runs: int | None = None,
        beyond: bool = True,
        progress: Progress | None = None,
        **options: Any,
    ) -> Report:
        """Run the experiment and return the content of its JSON file."""


def experiment(
    own: type[Repeated], *, options: str = "", **others: type[Settings]
) -> Callable[[Callable[..., Report]], Run]:
    """Return a decorator that makes an experiment of a function that computes its cells.

    The function gets an `Ensemble`, its settings, the `others` in their order, and by keyword ``beyond`` and its own options, if
    it has such arguments. It returns the report without the seed and the settings. Its entries under ``settings`` are added to
    the settings, those under ``chosen`` are put before them.

    Parameters
    ----------
    own : type of Repeated
        Class of its settings.
    options : str
        Description of its own options, in the form of a docstring.
    **others : type of Settings
        Classes of further settings, by the name of the argument.
    """

    def decorate(compute: Callable[..., Report]) -> Run:
        named = {n: p.default for n, p in signature(compute).parameters.items() if p.kind is Parameter.KEYWORD_ONLY}
        defaults = {**DEFAULTS, **dict.fromkeys(others), **{n: d for n, d in named.items() if n not in DEFAULTS}}
        shown = Signature([Parameter(n, Parameter.KEYWORD_ONLY, default=d) for n, d in defaults.items()])

        @wraps(compute)
        def run(**given: Any) -> Report:
            bound = shown.bind(**given)
            bound.apply_defaults()
            got = bound.arguments
            settings = own.of(got["settings"], got["runs"])
            further = {name: got[name] or cls() for name, cls in others.items()}
            ensemble = Ensemble(got["seed"], got["jobs"], got["progress"])
            report = compute(ensemble, settings, *further.values(), **{name: got[name] for name in named})
            head = {"seed": got["seed"], **report.pop("chosen", {}), **settings.to_dict()}
            head |= {name: each.to_dict() for name, each in further.items()} | report.pop("settings", {})
            return {"settings": head, **report, "paper": report.get("paper", {})}

        run.__signature__ = shown  # type: ignore[attr-defined]
        words = {
            "others": "".join(f", {name}" for name in others),
            "classes": ", ".join(cls.__name__ for cls in (own, *others.values())),
            "own": f"\n{cleandoc(options)}" if options else "",
        }
        run.__doc__ = f"{cleandoc(compute.__doc__ or '')}\n\n{COMMON.format(**words)}"
        return run

    return decorate
