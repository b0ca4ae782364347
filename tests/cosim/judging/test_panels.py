"""Labels beside panels fit the height of their panels."""

import pytest

from bayesftc.cosim.judging.panels import PANEL, broken


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
