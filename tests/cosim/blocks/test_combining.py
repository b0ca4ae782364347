"""Products, smallest and largest, switches, logic: against NumPy."""

import itertools
import operator

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim.errors import ModelError


def result(block, compiled, **inputs):
    return float(block.online(dt=1, compiled=compiled)(**inputs).y)


@pytest.mark.parametrize("compiled", [False, True])
def test_products_and_quotients(compiled):
    assert result(cosim.Product("**/"), compiled, u=[3.0, 4.0, 8.0]) == 1.5
    assert result(cosim.Product("/"), compiled, u=[4.0]) == 0.25
    assert result(cosim.Product("*/"), compiled, u=[1.0, 0.0]) == np.inf
    assert np.isnan(result(cosim.Product(), compiled, u=[np.nan, 1.0]))


@pytest.mark.parametrize("compiled", [False, True])
def test_smallest_and_largest_of_those_that_are_there(compiled):
    for u in ([3.0, 1.0, 2.0], [np.nan, 1.0, 2.0], [2.0, np.nan, np.nan]):
        assert result(cosim.Minimum(3), compiled, u=u) == np.nanmin(u)
        assert result(cosim.Maximum(3), compiled, u=u) == np.nanmax(u)
    assert np.isnan(result(cosim.Maximum(2), compiled, u=[np.nan, np.nan]))


@pytest.mark.parametrize("compiled", [False, True])
def test_a_switch_takes_the_other_where_the_condition_is_missing(compiled):
    for condition, expected in ((1.0, 5.0), (0.5, 7.0), (np.nan, 7.0)):
        assert result(cosim.Switch(), compiled, condition=condition, above=5.0, otherwise=7.0) == expected
    assert result(cosim.Switch(), compiled, condition=0.0, above=np.nan, otherwise=7.0) == 7.0


@pytest.mark.parametrize("compiled", [False, True])
def test_logic_is_pythons(compiled):
    for u in itertools.product((0.0, 1.0, np.nan), repeat=3):
        truth = [value > 0.5 for value in u]
        expected = {"and": all(truth), "or": any(truth), "xor": sum(truth) % 2 == 1}
        for operation, value in expected.items():
            assert result(cosim.Logic(operation, 3), compiled, u=list(u)) == value
    assert [result(cosim.Logic("not"), compiled, u=[v]) for v in (0.0, 1.0, np.nan)] == [1.0, 0.0, 1.0]


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize(
    ("relation", "holds"),
    [
        ("<", operator.lt),
        ("<=", operator.le),
        ("==", operator.eq),
        ("!=", operator.ne),
        (">=", operator.ge),
        (">", operator.gt),
    ],
)
def test_comparisons_are_those_of_numbers(relation, holds, compiled):
    for u in itertools.product((0.0, 1.0, np.nan), repeat=2):
        assert result(cosim.Compare(relation), compiled, u=list(u)) == holds(*u)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: cosim.Product("*+"), "give a \\* or /"),
        (lambda: cosim.Minimum(0), "size=0"),
        (lambda: cosim.Logic("nand"), "operation='nand'; did you mean 'and'"),
        (lambda: cosim.Logic("not", 2), "size=2; it must be 1 for 'not'"),
        (lambda: cosim.Compare("="), "must be one of < <= =="),
    ],
)
def test_wrong_settings_are_refused_with_a_sentence(make, words):
    with pytest.raises(ModelError, match=words):
        make()
