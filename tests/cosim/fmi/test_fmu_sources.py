"""FMUs without a binary for this machine are compiled from their sources, once, with the same numbers as the shipped ones."""

import logging
import re
import zipfile

import numpy as np
import pytest

from bayesftc import cosim, fmus
from bayesftc.cosim.errors import FMUError
from bayesftc.cosim.fmi.binaries.loading import _loaded
from bayesftc.cosim.fmi.fmu import FMU, describe
from bayesftc.cosim.fmi.reading.archive import open_archive
from bayesftc.cosim.fmi.reading.sources import read_sources

pytestmark = pytest.mark.usefixtures("c_compiler")


def without_binary(fmi, target, changes=None, drop=("binaries/",)):
    """Copy the shipped car with entries edited by functions of their text, or left out."""
    with zipfile.ZipFile(fmus.path("CruiseControl", fmi=fmi)) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            change = (changes or {}).get(name)
            if not name.startswith(drop):
                new.writestr(name, change(content.decode()).encode() if change else content)
    return target


def coast(path):
    diagram = cosim.Diagram(dt=0.02)
    diagram.add(FMU(path, parameters={"force": 100.0, "v0": 3.0}), "car")
    return diagram.simulate(1, engine="interpreted")["car.v"]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_sources_are_compiled_once_and_give_the_same_bits(tmp_path, monkeypatch, caplog, fmi):
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "cache"))
    path = without_binary(fmi, tmp_path / "car.fmu")
    with caplog.at_level(logging.WARNING, logger="bayesftc.fmu"):
        first = coast(path)
    assert [r.getMessage() for r in caplog.records if "compiling" in r.getMessage()] == [
        f"The FMU car.fmu has no binary for {describe_platform(fmi)}: compiling its sources."
    ]
    np.testing.assert_array_equal(first, coast(fmus.path("CruiseControl", fmi=fmi)))
    binary = next((tmp_path / "cache" / "fmus").glob(f"*/binaries/{describe_platform(fmi)}/CruiseControl.*"))
    stamp = binary.stat().st_mtime_ns
    _loaded.pop((open_archive(path).digest, False))  # as another process would find it
    caplog.clear()
    np.testing.assert_array_equal(first, coast(path))
    assert binary.stat().st_mtime_ns == stamp
    assert not caplog.records
    assert [p.name for p in binary.parent.iterdir()] == [binary.name]


def prefixed(text):
    """Return sources as the standard wants them: the functions have the model's name before their own."""
    return "#define FMI2_FUNCTION_PREFIX CruiseControl_\n#define FMI3_FUNCTION_PREFIX CruiseControl_\n" + text


def old_header(text):
    """Return a header as it was before FMI 2.0.4, which lets nobody leave the model's name out."""
    joined = "#define fmi2Joined(a, b) a ## b\n#define fmi2Joint(a, b) fmi2Joined(a, b)\n"
    text, count = re.subn(
        r"#\s*define fmi2FullName\(name\).*", "#define fmi2FullName(name) fmi2Joint(FMI2_FUNCTION_PREFIX, name)", text
    )
    assert count >= 1
    return joined + text


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("fmi", "header"), [("3.0", None), ("2.0", None), ("2.0", old_header)])
def test_functions_with_the_models_name_before_them_get_their_own_names(tmp_path, monkeypatch, fmi, header):
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "cache"))
    changes = {f"sources/fmi{fmi[0]}.c": prefixed} | ({"sources/fmi2Functions.h": header} if header else {})
    path = without_binary(fmi, tmp_path / "car.fmu", changes)
    np.testing.assert_array_equal(coast(path), coast(fmus.path("CruiseControl", fmi=fmi)))


def test_sources_without_the_functions_of_fmi_are_no_sources(tmp_path, monkeypatch):
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "cache"))
    empty = without_binary("2.0", tmp_path / "car.fmu", {"sources/fmi2.c": lambda text: "int nothing;\n"})
    with pytest.raises(
        FMUError, match=r"its sources cannot be compiled: they do not define the functions of FMI. Export it"
    ):
        FMU(empty).instantiate(cosim.Diagram(0.1).step, "car")


def describe_platform(fmi):
    import fmpy

    return fmpy.platform if fmi == "2.0" else fmpy.platform_tuple


def test_what_a_compiler_refuses_is_quoted(tmp_path, monkeypatch):
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "cache"))
    broken = without_binary("2.0", tmp_path / "broken.fmu", {"sources/CruiseControl.c": lambda s: s + "\nint x = ;\n"})
    with pytest.raises(
        FMUError, match=r"(?s)its sources cannot be compiled: .*CruiseControl\.c.*Export it for"
    ) as caught:
        FMU(broken).instantiate(cosim.Diagram(0.1).step, "car")
    assert str(tmp_path / "cache") not in str(caught.value)
    assert not list((tmp_path / "cache" / "fmus").glob("*/binaries/*/*"))


def test_without_a_compiler_the_sentence_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "cache"))
    path = without_binary("3.0", tmp_path / "car.fmu", {"sources/model.h": lambda s: s + "\n"})
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(FMUError, match=r"No C compiler for this machine was found .*pip install ziglang"):
        FMU(path).instantiate(cosim.Diagram(0.1).step, "car")


def test_what_counts_as_sources(tmp_path):
    def of(fmi, name, changes=None, drop=("binaries/",)):
        path = without_binary(fmi, tmp_path / f"{name}.fmu", changes, drop)
        return read_sources(open_archive(path), describe(path))

    build = "sources/buildDescription.xml"
    assert of("2.0", "two").files == ("fmi2.c", "CruiseControl.c")
    assert of("3.0", "three").files == ("fmi3.c", "CruiseControl.c")
    assert of("2.0", "none", drop=("binaries/", "sources/")) is None
    assert of("2.0", "part", drop=("binaries/", "sources/fmi2.c")) is None
    assert of("3.0", "plus", {build: lambda s: s.replace("C99", "C++11")}) is None
    assert of("3.0", "other", {build: lambda s: s.replace('Identifier="Cruise', 'Identifier="Snooze')}) is None
    outside = '<IncludeDirectory name="../../etc"/></SourceFileSet>'
    assert of("3.0", "outside", {build: lambda s: s.replace("</SourceFileSet>", outside)}) is None
    defined = '<PreprocessorDefinition name="A" value="1 2"/><IncludeDirectory name="inc"/></SourceFileSet>'
    found = of("3.0", "defined", {build: lambda s: s.replace("</SourceFileSet>", defined)})
    assert (found.definitions, found.includes, found.libraries) == (("A=1 2",), ("inc",), ())
