"""Labels beside panels fit the height of their panels."""

import numpy as np
import pytest

from bayesftc.cosim.judging.panels import PANEL, broken, finish, make_panels


@pytest.mark.parametrize(
    ("label", "lines"),
    [
        ("level (m)", "level (m)"),
        ("belief\nlevel (m)", "belief\nlevel (m)"),
        ("a.actuator_fault_probability", "a.actuator_fault_\nprobability"),
        ("TT-4402 temperature of the outlet (degC)", "TT-4402 temperature of\nthe outlet (degC)"),
        ("W" * 30, "W" * 24 + "\n" + "W" * 6),
        ("", ""),
    ],
)
def test_a_long_label_has_several_lines(label, lines):
    assert broken(label, PANEL) == lines


def test_a_lower_panel_has_shorter_lines_and_small_letters_longer_ones():
    assert broken("LT201 ultrasonic\n(m)", 0.85, 8.0) == "LT201\nultrasonic\n(m)"
    assert broken("LT201 ultrasonic\n(m)", 0.85, 5.0) == "LT201 ultrasonic\n(m)"


@pytest.mark.parametrize(
    ("largest", "texts"),
    [(2e-5, {"0", "1e−05", "2e−05"}), (3e7, {"0", "2e+07"}), (0.2, {"0.0", "0.1", "0.2"})],
)
def test_no_exponent_stands_above_a_panel(largest, texts):
    """There are the names of faults: matplotlib wrote its 1e-5 over them."""
    figure, axes = make_panels([1.5, 1.5])
    time = np.linspace(0.0, 10.0, 50)
    for axis in axes:
        axis.plot(time, largest * np.sin(time))
    axes[1].set_yscale("log")
    finish(axes, time)
    figure.draw_without_rendering()
    assert axes[0].yaxis.get_offset_text().get_text() == ""
    assert texts <= {label.get_text() for label in axes[0].get_yticklabels()}
