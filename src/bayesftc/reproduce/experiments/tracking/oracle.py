"""The errors of each technique relative to the oracle, which ignores the faulty sensor, for every kind and size of fault.

Errors are root mean squares over all runs of a cell, not means over runs, so they show a technique that loses the car once in a
thousand runs. Ratios below 1 are possible, because a sensor with a known offset has information that the oracle does not use.
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
    bench: Bench, learners: Mapping[str, controllers.PrecisionLearner], often: Collection[str]
) -> dict[str, Any]:
    """Return for each cell and technique the ratio of its error to the oracle's, on the same noise, with a 95 % interval.

    The oracle and the techniques in `often` have ``oracle_factor`` times as many runs; the others have only the first of them.
    Under ``cells`` each "fault size/reference" has its ``bar``, ``oracle`` (its error in m/s) and the ``ratio`` by technique
    (``ratio``, ``ratio_ci``, ``n``).
    """
    s = bench.settings
    longer = replace(bench, settings=s.of_size(s.runs * s.oracle_factor))
    bars = {
        Scenario(fault, reference, size or None): bar
        for (fault, size, bar), reference in product(s.oracle_cells, REFERENCES)
    }
    judged, others = (
        {name: learners[name] for name in learners if (name in often) == is_one} for is_one in (True, False)
    )
    scenarios = list(bars)
    oracle = longer.measure(
        "The oracle, often", scenarios, {ORACLE: controllers.FixedPrecision()}, drop_faulty=True
    ).errors()
    found = longer.measure("Over the oracle, often", scenarios, judged).errors()
    rest = bench.measure("Over the oracle", scenarios, others).errors()
    return {
        "cells": {
            c.name: {
                "bar": bars[c],
                "oracle": float(np.sqrt(np.mean(oracle[c][ORACLE] ** 2))),
                "ratio": {name: rms_ratio((found[c] | rest[c])[name], oracle[c][ORACLE]) for name in learners},
            }
            for c in scenarios
        }
    }
