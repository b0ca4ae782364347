"""Descriptions with sizes that no machine has room for: refused in a sentence before anything is allocated."""

import resource
import sys
import zipfile

import pytest

from bayesftc.cosim.base import archives as _zip
from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.fmi.fmu import FMU, describe

N = '<UInt64 name="n" valueReference="1" causality="structuralParameter" variability="fixed" start="{}"/>'


def described(folder, dimensions, more="", identifier="Sizes"):
    path = folder / "sizes.fmu"
    rows = more + "".join(
        f'<Float64 name="{name}" valueReference="{i}" {kind}>{dimensions}</Float64>'
        for i, (name, kind) in enumerate({"y": 'causality="output"', "p": 'causality="parameter" start="1"'}.items(), 2)
    )
    text = (
        '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="3.0" modelName="Sizes" instantiationToken="s">'
        f'<CoSimulation modelIdentifier="{identifier}"/><ModelVariables>{rows}'
        '<Float64 name="time" valueReference="9" causality="independent"/></ModelVariables><ModelStructure>'
        '<Output valueReference="2"/><InitialUnknown valueReference="2"/></ModelStructure></fmiModelDescription>'
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
    return path


@pytest.fixture
def little_memory():
    """Give this process 500 MB more than it has."""
    if sys.platform != "linux":
        pytest.skip("needs Linux")
    with open("/proc/self/statm", encoding="ascii") as file:
        now = int(file.read().split()[0]) * resource.getpagesize()
    limits = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (now + 500_000_000, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, limits)


@pytest.mark.parametrize("validate", [True, False])
@pytest.mark.parametrize(
    ("dimensions", "more", "shape"),
    [
        ('<Dimension start="18446744073709551615"/>', "", r"\(18446744073709551615,\)"),
        ('<Dimension start="1000"/>' * 3, "", r"\(1000, 1000, 1000\)"),
        ('<Dimension valueReference="1"/>', N.format(2**64 - 1), r"\(18446744073709551615,\)"),
        ('<Dimension start="3000"/>' * 2, "", r"\(3000, 3000\), and all variables together 18,000,001 numbers"),
    ],
)
def test_arrays_that_no_memory_holds(tmp_path, little_memory, dimensions, more, shape, validate):
    with pytest.raises(
        FMUError, match=f"'y' of the FMU sizes.fmu would have the shape {shape}: more than 10,000,000 numbers"
    ):
        describe(described(tmp_path, dimensions, more), validate=validate)


def test_a_structural_parameter_that_makes_them_so(tmp_path, little_memory):
    path = described(tmp_path, '<Dimension valueReference="1"/>', N.format(3))
    assert describe(path).variables[1].shape == (3,)
    with pytest.raises(FMUError, match=r"'y' of the FMU sizes.fmu would have the shape \(9223372036854775807,\)"):
        FMU(path, parameters={"n": 2**63 - 1})


@pytest.mark.parametrize(
    ("validate", "said"), [(True, "'9{3,200}"), (False, "it contains a number of thousands of digits")]
)
def test_a_size_of_thousands_of_digits(tmp_path, validate, said):
    with pytest.raises(FMUError, match=f"breaks the rules of FMI: .*{said}") as caught:
        describe(described(tmp_path, f'<Dimension start="{"9" * 6000}"/>'), validate=validate)
    assert len(str(caught.value)) < 1500


@pytest.mark.parametrize("validate", [True, False])
def test_a_model_identifier_that_is_no_name_of_a_file(tmp_path, validate):
    with pytest.raises(
        FMUError, match=r"modelIdentifier of 5,000 characters, 'M{20}' and so on\. The name of a binary has at most 240"
    ):
        describe(described(tmp_path, "", identifier="M" * 5000), validate=validate)
    assert describe(described(tmp_path, "", identifier="M" * 240)).identifier == "M" * 240


@pytest.mark.parametrize("what", ["ContinuousStates", "EventIndicators"])
@pytest.mark.parametrize("count", [2**32 - 1, -1])
def test_numbers_of_states_and_indicators_that_no_memory_holds(tmp_path, little_memory, what, count):
    path = tmp_path / "counts.fmu"
    counts = {"ContinuousStates": 0, "EventIndicators": 0} | {what: count}
    told = " ".join(f'numberOf{name}="{number}"' for name, number in counts.items())
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(
            "modelDescription.xml",
            f'<fmiModelDescription fmiVersion="1.0" modelName="C" modelIdentifier="C" guid="c" {told}><ModelVariables/>'
            "</fmiModelDescription>",
        )
    with pytest.raises(FMUError, match=rf"it declares {count:,} .*, but must have from 0 to 10,000,000"):
        describe(path, validate=False)


def test_more_variables_than_can_be_read(tmp_path, monkeypatch):
    monkeypatch.setattr(_zip, "MOST_VARIABLES", 1000)
    few = "".join(f'<Float64 name="v{i}" valueReference="{i}" causality="local"/>' for i in range(10, 1007))
    assert len(describe(described(tmp_path, "", few)).variables) == 1000
    with pytest.raises(
        FMUError, match=r"has more than 1,000 variables, which takes too long to read.*without its protected"
    ):
        describe(described(tmp_path, "", few + '<Float64 name="w" valueReference="5000" causality="local"/>'))


@pytest.mark.slow
def test_a_million_variables_are_refused_at_once(tmp_path, bayesftc_, little_memory):
    many = "".join(f'<Float64 name="v{i}" valueReference="{i}" causality="local"/>' for i in range(10, 1_000_010))
    refused = bayesftc_("inspect", described(tmp_path, "", many))
    assert refused.exit_code == FMUError.exit_code
    assert "has more than 300,000 variables" in refused.output
