"""Units: what their names mean, against pint's own reading and the SI; hostile names; conversions."""

import time

import numpy as np
import pint
import pytest

from bayesftc.cosim.base import units

REGISTRY = pint.UnitRegistry()


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        ("N.m", "newton * meter"),
        ("Nm", "newton * meter"),
        ("kg.m2/s2", "kg * m**2 / s**2"),
        ("kg m^2 / s**2", "joule"),
        ("m s⁻²", "m / s**2"),
        ("m/(s.K)", "m / s / K"),
        ("1/(kg.(m/s))", "s / kg / m"),
        ("rev/min", "rpm"),
        ("Ohm.m", "ohm * m"),
        ("µm", "1e-6 m"),
        ("l/min", "liter / minute"),
        ("kWh", "3.6 MJ"),
    ],
)
def test_spellings_mean_what_pint_says(ours, theirs):
    unit = units.parse(ours)
    wanted = REGISTRY.Quantity(theirs).to_base_units()
    assert unit.factor == pytest.approx(wanted.magnitude, rel=1e-14)
    assert dict(unit.powers) == dict(wanted.unit_items())
    assert unit.offset == 0.0


@pytest.mark.parametrize(
    "text",
    [
        "",
        "p.u.",
        "dB",
        "m**9**9",
        "m**999",
        "10 m",
        "(m",
        "m)",
        "m//s",
        "/s",
        "m/",
        "m_s",
        "__import__",
        "x" * 101,
        "m" + "*m" * 200,
        "9" * 1000,
        "(" * 50,
        "m\x00",
        "km²³⁴",
    ],
)
def test_what_is_no_unit_is_none_at_once(text):
    begin = time.perf_counter()
    assert units.parse(text) is None
    assert time.perf_counter() - begin < 2.0


def test_offsets_count_alone_and_not_in_products():
    celsius, fahrenheit, kelvin = (units.parse(name) for name in ("degC", "degF", "K"))
    gain, offset = units.gain(fahrenheit, celsius)
    np.testing.assert_allclose([gain * x + offset for x in (-40.0, 32.0, 212.0)], [-40.0, 0.0, 100.0], atol=1e-12)
    assert units.gain(celsius, kelvin) == (1.0, 273.15)
    assert units.difference("W/(m2.degC)", "W/m2/K") is None


def test_a_radian_is_one_but_no_cycle():
    assert units.difference("rad/s", "1/s") is None
    assert units.difference("Hz", "1/s") is None
    assert units.difference("N.m/rad", "N.m") is None
    for other in ("rad/s", "rpm", "deg/s"):
        assert "1 Hz is 2 pi rad/s" in units.difference("kHz", other)


def test_numbers_with_units():
    assert units.split("3.6 km/h") == (3.6, "km/h")
    assert units.split(" -1e-3kg ") == (-1e-3, "kg")
    for text in ("5", "heavy", "", "nan m", "1e m2"):
        assert units.split(text) is None or text == "1e m2"
