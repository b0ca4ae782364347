"""What all experiments take, check and report; each one says its settings and computes its cells."""

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
    Seed of all that is random.
jobs : int
    Number of threads; the results are the same to the last bit for any.
runs : int, optional
    Repetitions, instead of the settings'.
beyond : bool
    Whether what is not in the paper is run as well; without effect where nothing is in the paper.
settings{others}
    Other settings than those of `bayesftc.reproduce.settings`: {classes}.
progress : callable, optional
    Called as ``progress(what, done, of)``.{own}

Returns
-------
dict
    What the experiment's JSON file holds.

Raises
------
ModelError
    If a seed, a number of jobs or a number of repetitions cannot be one, or a setting is wrong."""


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
        """Run the experiment and return what its JSON file holds."""


def experiment(
    own: type[Repeated], *, options: str = "", **others: type[Settings]
) -> Callable[[Callable[..., Report]], Run]:
    """Return a decorator that makes an experiment of a function which computes its cells.

    The function is called with an `Ensemble` and its settings, then the `others` in their order, and by keyword with those of
    ``beyond`` and of its own options that it names. It returns the report without the seed and the settings. What it has under
    ``settings`` is added to them, and what it has under ``chosen`` stands before them.

    Parameters
    ----------
    own : type of Repeated
        Class of its settings.
    options : str
        Description of its own options, as a part of a docstring.
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
