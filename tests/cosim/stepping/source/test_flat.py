"""Functions without records: what is left of them computes the same, and takes only what it uses."""

import ast
from typing import NamedTuple

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim import Port
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.stepping.source.flat import without_records
from bayesftc.cosim.stepping.source.tree import parameters, tree_of


class Pair(NamedTuple):
    first: np.ndarray
    second: np.ndarray


class Nested(NamedTuple):
    pair: Pair
    rest: np.ndarray


def total(x):
    return x[0] + x[1]


def of_second(pair, factor=2.0):
    pair.second[0] = pair.second[0] * factor
    return pair.second[0]


def through(nested, rest):
    inner, own = nested
    return of_second(inner, factor=3.0) + own[0] + rest


def makes(y, u, x):
    nested = Nested(Pair(u, x), y)
    y[0] = 1.0
    y[1] = through(rest=total(u), nested=nested)
    pair, kept = nested.pair, total(x)
    y[2] = of_second(pair) + kept + pair.first[1]


def keeps_numbers_as_they_were(y, u, x):
    value = u[0]
    pair = Pair(value, u[1] + of_second(Pair(u, x)))
    value = 100.0
    y[0] = pair.first + pair.second + value
    for i in range(2):
        again = Pair(i, x)
        y[1 + i] = again.first + again.second[0]


def hands_on_what_is_made(y, u, x):
    y[0] = of_second(Pair(second=x, first=y))
    y[1], y[2] = u[0], u[1]


@pytest.mark.parametrize("kernel", [makes, keeps_numbers_as_they_were, hands_on_what_is_made])
def test_the_bits_stay(kernel, same_bits):
    found = []
    for function in (kernel, without_records(kernel)):
        y, u, x = np.zeros(3), np.array([0.1, 0.7]), np.array([1.3, -2.0])
        function(y, u, x)
        found.append(np.concatenate([y, u, x]))
    same_bits(*found)
    assert found[0].any()
    assert "Pair" not in ast.dump(tree_of(without_records(kernel)))


def test_functions_take_the_fields_that_they_use():
    called = without_records(makes).__globals__
    assert parameters(called["of_second_"]) == ("pair_second", "factor")
    assert parameters(called["through_"]) == ("nested_pair_second", "nested_rest", "rest")


def test_a_function_that_has_nothing_to_do_with_records_stays_itself():
    assert without_records(total) is total


def test_the_same_function_is_made_once_until_something_that_it_uses_is_another(monkeypatch):
    once = without_records(makes)
    assert without_records(makes) is once
    monkeypatch.setitem(globals(), "total", lambda x: 0.0 * x[0])
    assert without_records(makes) is not once


def compares(y, u, x):
    y[0] = 1.0 if Pair(u, x) == Pair(x, u) else 0.0


def takes_by_number(y, u, x):
    pair = Pair(u, x)
    y[0] = pair[0][0]


def makes_in_a_condition(y, u, x):
    while of_second(Pair(u, u[0] + x)) < 10.0:
        y[0] = 1.0


def names_twice(y, u, x):
    pair = Pair(u, x)
    pair = Pair(x, pair.first)
    y[0] = pair.first[0]


def made(u, x):
    return Pair(u, x)


def is_given_one(y, u, x):
    y[0] = made(u, x).first[0]


def between_calls(y, u, x):
    y[0] = total(x) + of_second(Pair(u, x)) + of_second(Pair(u[0], x))


def wrong_field(y, u, x):
    y[0] = Pair(u, x).third[0]


def too_few(y, u, x):
    y[0] = of_second(Pair(u)) + x[0]


def as_a_number(y, u, x):
    y[0] = 1.0 + Pair(u, x)


REFUSED = {
    compares: "creates a record where a number or an array is needed",
    takes_by_number: "uses the record 'pair' as a whole; use its fields",
    makes_in_a_condition: "creates a record in the condition of a loop|creates a record in a line with other calls",
    names_twice: "assigns the record 'pair' more than once; use two names",
    is_given_one: "returns a record; return numbers, or write into arrays",
    between_calls: "creates a record in a line with other calls",
    wrong_field: "uses the attribute 'third', but the record has first, second",
    too_few: r"calls 'Pair' with wrong arguments; its arguments are first, second",
    as_a_number: "creates a record where a number or an array is needed",
}


@pytest.mark.parametrize("kernel", REFUSED, ids=lambda f: f.__name__)
def test_refused(kernel):
    with pytest.raises(KernelError, match=rf"\(test_flat.py, line \d+\) ({REFUSED[kernel]})"):
        without_records(kernel)


def test_numba_compiles_what_cannot_be_made_flat(make_block):
    block = make_block(inputs=[Port("u", (2,))], outputs=[Port("y")], output=takes_by_number, state={"x": [1.0, 2.0]})
    assert block.online(1)(u=[0.25, 0.5]).y == 0.25
    with pytest.raises(KernelError, match="uses the record 'pair' as a whole"):
        cosim.export_c(block, "nowhere", dt=1.0)
