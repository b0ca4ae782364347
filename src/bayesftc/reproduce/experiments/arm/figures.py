"""Figures of the arm experiment, drawn from its report alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayesftc.cosim.judging.figures.plotting import BLACK, BLUE, SENSOR_COLOURS
from bayesftc.reproduce.experiments.arm.tables import LABELS
from bayesftc.reproduce.shared.drawing import figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LINES: dict[str, dict[str, Any]] = {
    "goal": {"color": BLACK, "ls": ":", "lw": 1.2},
    "angle": {"color": BLUE, "lw": 2.6},
    "belief": {"color": SENSOR_COLOURS[0], "ls": "--", "lw": 1.4},
}
SHOWN = ("none", "implicit", "explicit")


def trajectories(report: dict[str, Any]) -> Figure:
    """Return both joints' angles over time with belief and goal, for the paper's three controllers."""
    settings = report["settings"]
    made = figure(11.0, 5.6)
    axes = made.subplots(2, len(SHOWN), sharex=True, sharey="row")
    for column, name in enumerate(SHOWN):
        drawn = {key: np.asarray(values) for key, values in report["trajectories"][name].items()}
        for joint, axis in enumerate(axes[:, column]):
            fault = settings["fault_start"], settings["duration"]
            axis.axvspan(*fault, color="#D55E00", alpha=0.12, lw=0, label="fault")
            for what, look in LINES.items():
                axis.plot(drawn["time"], drawn[what][:, joint], label=what, **look)
            tidy(axis)
        axes[0, column].set_title(LABELS[name], fontsize=10, loc="left")
        axes[1, column].set_xlabel("time (s)")
    for joint, axis in enumerate(axes[:, 0]):
        axis.set_ylabel(f"angle of joint {joint + 1} (rad)")
        axis.set_xlim(0, settings["duration"])
    handles, labels = axes[0, 0].get_legend_handles_labels()
    made.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return made


FIGURES = {"arm_trajectories": trajectories}
