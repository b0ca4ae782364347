"""What a measurement yields: figures with their bars, from which both the table and the JSON are made."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any


@dataclass(frozen=True)
class Figure:
    """One measured quantity."""

    # Its name in the JSON, what it is in words, and its unit (empty for a plain number).
    key: str
    label: str
    unit: str
    samples: Sequence[float]  # A value for each repetition; empty where it could not be measured
    # The bars that its median should clear.
    at_least: float | None = None
    at_most: float | None = None
    # Figures of one section with the same word here are alternatives: one that clears its bar is enough.
    either: str | None = None
    reason: str | None = None  # why there are no samples, as a sentence
    note: str = ""  # what else there is to say

    @property
    def value(self) -> float | None:
        """The median of the samples."""
        return float(median(self.samples)) if self.samples else None

    @property
    def has_bar(self) -> bool:
        """Whether there is anything to clear."""
        return self.at_least is not None or self.at_most is not None

    @property
    def clears(self) -> bool | None:
        """Whether the median clears the figure's own bars; None without bars or samples."""
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
    reason: str | None = None  # why there are no figures, as a sentence

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name as plain data; of a section without figures, the reason."""
        return {f.key: f.as_json() for f in self.figures} | ({"reason": self.reason} if self.reason else {})

    def met(self, figure: Figure) -> bool | None:
        """Return whether a figure's bar is met, by itself or by its alternative; None where that is not known."""
        verdicts = [
            f.clears for f in self.figures if f is figure or (f.either is not None and f.either == figure.either)
        ]
        if True in verdicts:
            return True
        return None if None in verdicts else False

    def alternatives(self, figure: Figure) -> list[Figure]:
        """Return the other figures of which one is enough."""
        return [f for f in self.figures if f is not figure and f.either is not None and f.either == figure.either]

    def bars(self) -> dict[str, dict[str, Any]]:
        """Return each bar with the value that was measured, as plain data."""
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
    """Measure the candidates one after the other, `rounds` times, so that a busy minute falls on all of them alike."""
    samples: dict[str, list[float]] = {name: [] for name in candidates}
    for _ in range(rounds):
        for name, candidate in candidates.items():
            samples[name].append(candidate())
    return samples


def ratios(above: Iterable[float], below: Iterable[float]) -> list[float]:
    """Return the ratio within each round."""
    return [a / b for a, b in zip(above, below, strict=True)]
