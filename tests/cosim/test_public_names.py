"""Wrong names of the packages."""

import subprocess
import sys

import pytest

import bayesftc
from bayesftc import _public, controllers, cosim, fmus, monitoring
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
        (cosim, "Offset", "did you mean 'Bias'?"),  # not controllers.Offset, a mode of a learner
    ],
)
def test_a_name_of_another_tool_gets_the_one_here(package, name, hint):
    with pytest.raises(AttributeError, match="has no") as caught:
        getattr(package, name)
    assert str(caught.value).endswith(hint)


@pytest.mark.parametrize(
    ("package", "name", "there"),
    [
        (bayesftc, "design", "controllers.design"),
        (bayesftc, "FMU", "cosim.FMU"),
        (cosim, "design", "controllers.design"),
        (controllers, "closed_loop", "cosim.closed_loop"),
        (controllers, "Monitor", "monitoring.Monitor"),
        (monitoring, "diagnose", "controllers.diagnose"),
        (fmus, "FMU", "cosim.FMU"),
    ],
)
def test_a_name_of_another_package_is_said_to_be_there(package, name, there):
    with pytest.raises(AttributeError, match=f"^{package.__name__} has no '{name}'; it is {there}[.]$"):
        getattr(package, name)


def test_python_adds_no_suggestion_of_its_own():
    script = "from bayesftc import cosim; cosim.desing"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert run.stderr.rstrip().endswith("bayesftc.cosim has no 'desing'; did you mean 'Design' or 'Session'?")


def test_all_suggested_names_are_public():
    for word, names in _public._WORDS.items():
        assert word == word.lower().replace("_", "")
        for name in names:
            package, _, public = name.partition(".")
            assert public in PACKAGES[package].__all__


def test_kinds_of_scenarios_too():
    with pytest.raises(cosim.ScenarioError, match="no valid kind here; did you mean 'Pulse'"):
        choose([cosim.Pulse, cosim.Source], {"kind": "square"}, Place("file.toml"))
