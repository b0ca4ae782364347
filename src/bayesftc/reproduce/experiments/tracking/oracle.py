"""How close each technique comes to the oracle, which ignores the faulty sensor, for every kind and size of fault.

Errors are root mean squares over all runs of a cell, not means over runs: a technique that loses the car once in a thousand runs
shall not hide it. Below 1 is possible, because a sensor whose offset is known still informs, and the oracle does without it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from bayesftc import controllers
from bayesftc.cosim.statistics import rms_ratio
from bayesftc.reproduce.experiments.tracking.bench import ORACLE, REFERENCES, Bench, Scenario


def over_oracle(
    bench: Bench, known: Mapping[str, controllers.PrecisionLearner], often: Collection[str]
) -> dict[str, Any]:
    """Return for each cell and technique the ratio of its error to the oracle's, on the same noise, with a 95 % interval.

    The techniques in `often` make more runs, by the setting ``oracle_factor``, as the oracle does; the others make the first of
    them. Under ``cells`` each "fault size/reference" has its ``bar``, ``oracle`` (its error in m/s) and the ``ratio`` by
    technique (``ratio``, ``ratio_ci``, ``n``).
    """
    s = bench.settings
    longer = replace(bench, settings=s.of_size(s.runs * s.oracle_factor))
    bars = {
        Scenario(fault, reference, size or None): bar
        for (fault, size, bar), reference in product(s.oracle_cells, REFERENCES)
    }
    judged, others = ({name: known[name] for name in known if (name in often) == is_one} for is_one in (True, False))
    scenarios = list(bars)
    oracle = longer.measure("The oracle, often", scenarios, {ORACLE: controllers.FixedPrecision()}, told=True).errors()
    found = longer.measure("Over the oracle, often", scenarios, judged).errors()
    rest = bench.measure("Over the oracle", scenarios, others).errors()
    return {
        "cells": {
            c.name: {
                "bar": bars[c],
                "oracle": float(np.sqrt(np.mean(oracle[c][ORACLE] ** 2))),
                "ratio": {name: rms_ratio((found[c] | rest[c])[name], oracle[c][ORACLE]) for name in known},
            }
            for c in scenarios
        }
    }
