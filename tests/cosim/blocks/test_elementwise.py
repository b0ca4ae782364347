"""Blocks that change each element of a signal by itself, against NumPy and SciPy."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from bayesftc import cosim
from bayesftc.cosim.errors import ModelError

U = np.array([-3.0, -1.0, -0.4, -0.25, 0.0, 0.25, 0.3, 1.0, 1.5, 2.0, 7.0])
TABLE = [-1.0, 0.0, 0.5, 2.0], [3.0, 1.0, 4.0, -2.0]


def through(block, u=U, compiled=False):
    step = block.online(dt=0.1, compiled=compiled)
    return np.array([float(step(u=value).y) for value in u])


@pytest.mark.parametrize(
    ("block", "expected"),
    [
        (cosim.Abs(), np.abs),
        (cosim.Sign(), np.sign),
        (cosim.DeadZone(-0.3, 0.5), lambda u: u - np.clip(u, -0.3, 0.5)),
        (cosim.Quantizer(0.5), lambda u: 0.5 * np.floor(u / 0.5 + 0.5)),
        (cosim.Polynomial([2.0, 0.0, -1.0, 4.0]), lambda u: np.polyval([2.0, 0.0, -1.0, 4.0], u)),
        (cosim.LookupTable(*TABLE), lambda u: np.interp(u, *TABLE)),
        (
            cosim.LookupTable(*TABLE, interpolate=False),
            lambda u: np.array(TABLE[1])[np.maximum(np.searchsorted(TABLE[0], u, "right") - 1, 0)],
        ),
    ],
    ids=lambda value: getattr(value, "default_name", ""),
)
def test_each_element_is_numpys(block, expected):
    for compiled in (False, True):
        np.testing.assert_allclose(through(block, compiled=compiled), expected(U), rtol=1e-14, atol=1e-15)
        assert np.isnan(through(block, [np.nan], compiled))
    wide = type(block)(**{**vars(block), "size": 3}).online(dt=0.1)
    one, other = expected(np.array([-3.0, 0.3]))
    np.testing.assert_allclose(wide(u=[-3.0, np.nan, 0.3]).y, [one, np.nan, other], rtol=1e-14)


def test_a_table_of_two_inputs_is_scipys():
    rows, columns = [0.0, 1.0, 4.0], [-1.0, 1.0]
    values = [[0.0, 1.0], [5.0, -2.0], [3.0, 3.0]]
    scipys = RegularGridInterpolator((rows, columns), values)
    step = cosim.LookupTable2D(rows, columns, values).online(dt=1)
    for u, v in np.random.default_rng(0).uniform([0.0, -1.0], [4.0, 1.0], (30, 2)):
        assert step(u=u, v=v).y == pytest.approx(float(scipys((u, v))), rel=1e-12)
    assert step(u=-9.0, v=-9.0).y == 0.0
    assert step(u=9.0, v=9.0).y == 3.0
    assert np.isnan(step(u=np.nan, v=0.0).y)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: cosim.Abs(size=0), r"Abs has size=0; it must be a whole number"),
        (lambda: cosim.DeadZone(1.0, -1.0), "low must not lie above high"),
        (lambda: cosim.Quantizer(0.0), "interval=0.0; it must be a finite number above 0"),
        (lambda: cosim.Polynomial([]), "at least 1 finite numbers"),
        (lambda: cosim.LookupTable([0.0, 0.0], [1.0, 2.0]), "must rise strictly"),
        (lambda: cosim.LookupTable([0.0, 1.0], [1.0, 2.0, 3.0]), "2 points and 3 values"),
        (lambda: cosim.LookupTable2D([0, 1], [0, 1], [[1, 2]]), r"shape \(1, 2\); give 2 rows of 2"),
    ],
)
def test_wrong_settings_are_refused_with_a_sentence(make, words):
    with pytest.raises(ModelError, match=words):
        make()
