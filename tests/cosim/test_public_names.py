"""Wrong names of the packages."""

import pytest

from bayesftc import _public, controllers, cosim
from bayesftc.scenario._place import Place
from bayesftc.scenario._schema import choose

PACKAGES = {"cosim": cosim, "controllers": controllers}


@pytest.mark.parametrize(
    ("package", "name", "hint"),
    [
        (cosim, "Square", "did you mean 'Pulse'?"),
        (cosim, "pulse_generator", "did you mean 'Pulse'?"),
        (cosim, "Observer", "did you mean 'bayesftc.controllers.StateEstimator'?"),
        (controllers, "KalmanFilter", "did you mean 'StateEstimator'?"),
        (controllers, "LQG", "did you mean 'LQGController'?"),
    ],
)
def test_a_name_of_another_tool_gets_the_one_here(package, name, hint):
    with pytest.raises(AttributeError, match="has no") as caught:
        getattr(package, name)
    assert str(caught.value).endswith(hint)


def test_all_suggested_names_are_public():
    for word, names in _public._WORDS.items():
        assert word == word.lower().replace("_", "")
        for name in names:
            package, _, public = name.partition(".")
            assert public in PACKAGES[package].__all__


def test_kinds_of_scenarios_too():
    with pytest.raises(cosim.ScenarioError, match="no valid kind here; did you mean 'Pulse'"):
        choose([cosim.Pulse, cosim.Source], {"kind": "square"}, Place("file.toml"))
