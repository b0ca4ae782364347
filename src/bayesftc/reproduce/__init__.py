"""The paper's experiments and further ones, with the command ``bayesftc reproduce`` or from Python.

``reproduce.arm`` is experiment 1, ``reproduce.tracking`` experiment 2, ``reproduce.detection`` experiment 3. Beyond the paper,
``reproduce.bound`` computes the best possible detector, ``reproduce.models`` tests wrong models, ``reproduce.beliefs`` tests
wrong settings of fault modes, ``reproduce.probabilities`` tests fault probabilities, and ``reproduce.family`` runs all learners
over a family of faults. Each returns the content of its JSON file as plain data: ``reproduce.tracking(seed=0, jobs=2)``.
Settings and their reasons are in `bayesftc.reproduce.settings`, the paper's numbers in `bayesftc.reproduce.paper`.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bayesftc.reproduce.experiments.arm.run import run as arm
    from bayesftc.reproduce.experiments.beliefs.run import run as beliefs
    from bayesftc.reproduce.experiments.bound.run import run as bound
    from bayesftc.reproduce.experiments.detection.run import run as detection
    from bayesftc.reproduce.experiments.family.run import run as family
    from bayesftc.reproduce.experiments.models.run import run as models
    from bayesftc.reproduce.experiments.probabilities.run import run as probabilities
    from bayesftc.reproduce.experiments.tracking.run import run as tracking

__all__ = ["arm", "beliefs", "bound", "detection", "family", "models", "probabilities", "tracking"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        from bayesftc.reproduce.registry import EXPERIMENTS

        return EXPERIMENTS[name].run
    raise AttributeError(f"module 'bayesftc.reproduce' has no attribute {name!r}")
