"""The results of a measurement: figures with their bars, which the table and the JSON show."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any


@dataclass(frozen=True)
class Figure:
    """One measured quantity."""

    key: str  # name in the JSON
    label: str
    unit: str  # empty for a plain number
    samples: Sequence[float]  # one value per repetition; empty if it could not be measured
    # Limits of the median.
    at_least: float | None = None
    at_most: float | None = None
    # Figures of a section with the same word are alternatives: it is enough if one of them meets its bar.
    either: str | None = None
    reason: str | None = None  # a sentence on why there are no samples
    note: str = ""

    @property
    def value(self) -> float | None:
        """The median of the samples."""
        return float(median(self.samples)) if self.samples else None

    @property
    def has_bar(self) -> bool:
        """Whether the figure has a limit."""
        return self.at_least is not None or self.at_most is not None

    @property
    def clears(self) -> bool | None:
        """Whether the median meets the figure's own bars; None without bars or samples."""
        value = self.value
        if value is None or not self.has_bar:
            return None
        low, high = self.at_least, self.at_most
        return (low is None or value >= low) and (high is None or value <= high)

    def as_json(self) -> dict[str, Any]:
        """Return the figure as plain data."""
        spread = {"min": min(self.samples), "max": max(self.samples)} if self.samples else {"min": None, "max": None}
        plain = {"label": self.label, "unit": self.unit, "median": self.value, **spread, "samples": len(self.samples)}
        return plain | {name: text for name in ("reason", "note") if (text := getattr(self, name))}


@dataclass(frozen=True)
class Section:
    """The figures of one measurement."""

    key: str
    title: str
    figures: tuple[Figure, ...]
    reason: str | None = None  # a sentence on why there are no figures

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name as plain data; without figures, the reason."""
        return {f.key: f.as_json() for f in self.figures} | ({"reason": self.reason} if self.reason else {})

    def met(self, figure: Figure) -> bool | None:
        """Return whether a figure's bar is met, by itself or by an alternative; None if that is not known."""
        verdicts = [
            f.clears for f in self.figures if f is figure or (f.either is not None and f.either == figure.either)
        ]
        if True in verdicts:
            return True
        return None if None in verdicts else False

    def alternatives(self, figure: Figure) -> list[Figure]:
        """Return the alternatives of a figure."""
        return [f for f in self.figures if f is not figure and f.either is not None and f.either == figure.either]

    def bars(self) -> dict[str, dict[str, Any]]:
        """Return each bar with the measured value, as plain data."""
        return {
            f"{self.key}.{f.key}": {
                "value": f.value,
                **{name: limit for name in ("at_least", "at_most") if (limit := getattr(f, name)) is not None},
                **({"or": others} if (others := [f"{self.key}.{o.key}" for o in self.alternatives(f)]) else {}),
                "met": self.met(f),
                "reason": f.reason,
            }
            for f in self.figures
            if f.has_bar
        }


def in_turns(candidates: Mapping[str, Callable[[], float]], rounds: int) -> dict[str, list[float]]:
    """Measure the candidates in turns, `rounds` times, so that other load of the machine affects all equally."""
    samples: dict[str, list[float]] = {name: [] for name in candidates}
    for _ in range(rounds):
        for name, candidate in candidates.items():
            samples[name].append(candidate())
    return samples


def ratios(above: Iterable[float], below: Iterable[float]) -> list[float]:
    """Return the ratio within each round."""
    return [a / b for a, b in zip(above, below, strict=True)]
