"""Wrong names of the packages' public objects get similar ones."""

import re

import pytest

from bayesftc import controllers, cosim


@pytest.mark.parametrize(
    ("package", "name", "near"),
    [
        (cosim, "Freez", "'Freeze'"),
        (controllers, "desing", "'design'"),
        (controllers, "LQG", "'LQGController'"),  # the beginning of a name
    ],
)
def test_a_wrong_name_gets_similar_ones(package, name, near):
    with pytest.raises(AttributeError, match=re.escape(f"{package.__name__} has no {name!r}; did you mean {near}?")):
        getattr(package, name)


def test_special_attributes_are_plainly_missing():
    assert not hasattr(cosim, "__wrapped__")
