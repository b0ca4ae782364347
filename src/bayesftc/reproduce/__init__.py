"""The paper's experiments, our numbers beside its own: ``bayesftc reproduce``, or from Python.

``reproduce.arm`` is experiment 1, ``reproduce.tracking`` experiment 2, ``reproduce.detection`` experiment 3;
``reproduce.bound`` has the best that a detector could do there, ``reproduce.models`` asks what wrong models do, and
``reproduce.beliefs`` how wrong the settings of fault modes may be; ``reproduce.probabilities`` asks whether fault probabilities
are true, and ``reproduce.family`` runs all learners over a family of faults. Each returns what its JSON file holds, as plain
data: ``reproduce.tracking(seed=0, jobs=2)``. Settings and their reasons stand in `bayesftc.reproduce.settings`, the paper's own
numbers in `bayesftc.reproduce.paper`.
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
