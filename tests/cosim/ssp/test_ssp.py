"""System structures (SSP): opened as diagrams, saved for other tools, run by another tool with the same numbers."""

import json
import os
import pickle
import re
import subprocess
import sys
import warnings
import zipfile
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from bayesftc import cosim, fmus
from bayesftc.cosim import SSPError
from bayesftc.cosim.base import archives as _zip
from bayesftc.cosim.ssp.read import SSP_FILE

CAR = {fmi: fmus.path("CruiseControl", fmi=fmi) for fmi in ("2.0", "3.0")}
H, M, B = 0.02, 100.0, 5.0
SPACES = " ".join(
    f'xmlns:{prefix}="http://ssp-standard.org/SSP1/SystemStructure{kind}"'
    for prefix, kind in (
        ("ssd", "Description"),
        ("ssv", "ParameterValues"),
        ("ssm", "ParameterMapping"),
        ("ssc", "Common"),
    )
)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def component(name, *, fmi="2.0", connectors="", bindings="", **attributes):
    source = attributes.pop("source", f"resources/{CAR[fmi].name}")
    more = "".join(f' {k}="{v}"' for k, v in attributes.items())
    return f"""<ssd:Component name="{name}" source="{source}"{more}>
        <ssd:Connectors>{connectors or connected("input", "force", "disturbance") + connected("output", "v")}</ssd:Connectors>
        {bound(bindings)}</ssd:Component>"""


def connected(kind, *names, type="<ssc:Real/>"):
    return "".join(f'<ssd:Connector name="{name}" kind="{kind}">{type}</ssd:Connector>' for name in names)


def bound(bindings):
    return f"<ssd:ParameterBindings>{bindings}</ssd:ParameterBindings>" if bindings else ""


def values(units="", **parameters):
    """Return a parameter set; a number is a Real, a text is XML."""
    rows = "".join(
        f'<ssv:Parameter name="{name.replace("__", ".")}">'
        + (value if isinstance(value, str) else f'<ssv:Real value="{value}"/>')
        + "</ssv:Parameter>"
        for name, value in parameters.items()
    )
    rows = f"<ssv:Parameters>{rows}</ssv:Parameters>"
    return f'<ssv:ParameterSet {SPACES} version="1.0" name="set">{rows}{units}</ssv:ParameterSet>'


def inline(set_, **attributes):
    more = "".join(f' {k}="{v}"' for k, v in attributes.items())
    return f"<ssd:ParameterBinding{more}><ssd:ParameterValues>{set_}</ssd:ParameterValues></ssd:ParameterBinding>"


def link(start, end, inner="", **attributes):
    ends = ""
    for side, text in (("start", start), ("end", end)):
        element, _, connector = text.rpartition(".")
        ends += f' {side}Element="{element}"' if element else ""
        ends += f' {side}Connector="{connector}"'
    more = "".join(f' {k}="{v}"' for k, v in attributes.items())
    return f"<ssd:Connection{ends}{more}>{inner}</ssd:Connection>"


def system(elements, connections="", *, name="system", connectors="", bindings=""):
    wires = f"<ssd:Connections>{connections}</ssd:Connections>" if connections else ""
    own = f"<ssd:Connectors>{connectors}</ssd:Connectors>" if connectors else ""
    return (
        f'<ssd:System name="{name}">{own}{bound(bindings)}<ssd:Elements>{elements}</ssd:Elements>{wires}</ssd:System>'
    )


def ssd(inside, units="", version="1.0"):
    root = f'<ssd:SystemStructureDescription {SPACES} version="{version}" name="test">'
    return f'<?xml version="1.0" encoding="UTF-8"?>{root}{inside}{units}</ssd:SystemStructureDescription>'


def packed(folder, text, name="test.ssp", **files):
    path = folder / name
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", text)
        for car in CAR.values():
            archive.write(car, f"resources/{car.name}")
        for file, content in files.items():
            archive.writestr(file.replace("__", "."), content)
    return path


def run(path, steps=50, **options):
    options.setdefault("dt", "1/50")
    diagram = cosim.open_ssp(path, **options).build("jacobi")
    return diagram.simulate(steps * H, engine="interpreted")


def chain(steps=50, factor=1.0, offset=0.0, v0=1.0, force=100.0, b=B):
    """Return the speeds of two cars; the first one's, scaled, pushes the second."""
    first, second = np.zeros(steps + 1), np.zeros(steps + 1)
    first[0] = v0
    for k in range(steps):
        first[k + 1] = (1 - b / M * H) * first[k] + H / M * force
        second[k + 1] = (1 - B / M * H) * second[k] + offset + factor * first[k]
    return first, second


def check_chain(result, first="a.v", second="b.v", **expected):
    for name, wanted in zip((first, second), chain(**expected), strict=True):
        np.testing.assert_allclose(result[name], wanted, rtol=1e-12, atol=1e-12)


START = inline(values(v0=1.0, force=100.0))


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_two_components(tmp_path, fmi):
    text = ssd(system(component("a", fmi=fmi, bindings=START) + component("b"), link("a.v", "b.disturbance")))
    check_chain(run(packed(tmp_path, text)))
    # As a folder: the .ssd and what it refers to beside it.
    with zipfile.ZipFile(tmp_path / "test.ssp") as archive:
        archive.extractall(tmp_path / "folder")
    check_chain(run(tmp_path / "folder" / "SystemStructure.ssd"))


@pytest.mark.slow
def test_isolated_components(tmp_path, same_bits):
    text = ssd(system(component("a", bindings=START) + component("b"), link("a.v", "b.disturbance")))
    path = packed(tmp_path, text)
    assert cosim.open_ssp(path, dt=H, isolate=True)["b"].block.isolate
    same_bits(run(path, isolate=True, steps=10)["b.v"], run(path, steps=10)["b.v"])


def test_a_connection_may_be_written_from_its_end(tmp_path):
    text = ssd(system(component("a", bindings=START) + component("b"), link("b.disturbance", "a.v")))
    check_chain(run(packed(tmp_path, text)))


def test_transformations(tmp_path):
    linear = '<ssc:LinearTransformation factor="0.5" offset="0.125"/>'
    text = ssd(system(component("a", bindings=START) + component("b"), link("a.v", "b.disturbance", linear)))
    check_chain(run(packed(tmp_path, text)), factor=0.5, offset=0.125)


def test_systems_in_systems(tmp_path):
    """The value goes out of one system and into another, two deep, and is scaled on the way."""
    half, plus = ('<ssc:LinearTransformation factor="0.5"/>', '<ssc:LinearTransformation offset="0.25"/>')
    left = system(
        component("a", bindings=START), link("a.v", "out", half), name="left", connectors=connected("output", "out")
    )
    core = system(component("b"), link("in", "b.disturbance"), name="core", connectors=connected("input", "in"))
    right = system(core, link("in", "core.in"), name="right", connectors=connected("input", "in"))
    text = ssd(system(left + right, link("left.out", "right.in", plus)))
    result = run(packed(tmp_path, text))
    check_chain(result, "left.a.v", "right.core.b.v", factor=0.5, offset=0.25)


def test_what_a_variant_refers_to_is_relative_to_it(tmp_path):
    """And not to the archive, in which another file may have that name."""
    binding = '<ssd:ParameterBinding source="car.ssv"/>'
    text = ssd(system(component("a", bindings=binding, source="CruiseControl.fmu")))
    inside = {"other/one.ssd": text, "other/car.ssv": values(force=100), "car.ssv": values(force=7)}
    path = packed(tmp_path, ssd(system(A)), **inside)
    with zipfile.ZipFile(path, "a") as archive:
        archive.write(CAR["2.0"], "other/CruiseControl.fmu")
    assert cosim.open_ssp(path, dt=H, variant="other/one.ssd").nodes[0].block.start_value("force") == 100.0


def test_inputs_of_the_whole_keep_their_start_values_and_can_be_connected(tmp_path):
    text = ssd(system(component("a", bindings=START), link("in", "a.force"), connectors=connected("input", "in")))
    path = packed(tmp_path, text)
    np.testing.assert_allclose(run(path)["a.v"], chain()[0], rtol=1e-12)
    diagram = cosim.open_ssp(path, dt=H)
    diagram.connect(diagram.add(cosim.Constant(40.0), "push")["y"], diagram["a"]["force"])
    np.testing.assert_allclose(diagram.simulate(1.0, engine="interpreted")["a.v"], chain(force=40.0)[0], rtol=1e-12)


UNITS = """<ssd:Units><ssc:Unit name="furlong/fortnight"><ssc:BaseUnit m="1" s="-1" factor="0.00016630952380952381"/></ssc:Unit>
    <ssc:Unit name="m/s"><ssc:BaseUnit m="1" s="-1"/></ssc:Unit></ssd:Units>"""
SLOW = 0.00016630952380952381


def middle(unit):
    return connected("input", "in", type=f'<ssc:Real unit="{unit}"/>')


@pytest.mark.parametrize(
    ("unit", "linear", "suppress", "factor", "offset"),
    [
        ("furlong/fortnight", "", "false", 1.0, 0.0),
        ("km/h", "", "false", 1.0, 0.0),  # not defined in the file, but known
        ("furlong/fortnight", "", "true", SLOW, 0.0),
        ("furlong/fortnight", '<ssc:LinearTransformation factor="2" offset="3"/>', "false", 2.0, 3 * SLOW),
        ("km/h", '<ssc:LinearTransformation factor="2" offset="3"/>', "true", 2.0 / 3.6, 3.0 / 3.6),
    ],
)
def test_units_on_the_way(tmp_path, unit, linear, suppress, factor, offset):
    """From m/s to the unit of a system's connector, then back to m/s."""
    inner = system(component("b"), link("in", "b.disturbance"), name="s", connectors=middle(unit))
    wire = link("a.v", "s.in", linear, suppressUnitConversion=suppress)
    text = ssd(system(component("a", bindings=START) + inner, wire), UNITS)
    check_chain(run(packed(tmp_path, text)), second="s.b.v", factor=factor, offset=offset)


def test_units_that_cannot_be_converted(tmp_path):
    for unit, words in (
        ("kg", "from m/s to kg: their dimensions differ"),
        ("smoots", "the unit 'smoots' is not known"),
    ):
        inner = system(component("b"), link("in", "b.disturbance"), name="s", connectors=middle(unit))
        text = ssd(system(component("a") + inner, link("a.v", "s.in")))
        refused(packed(tmp_path, text), "The connection from a.v to s.in in SystemStructure.ssd", words)
    wrong = connected("output", "v", type='<ssc:Real unit="km/h"/>')
    text = ssd(system(component("a", connectors=wrong)))
    refused(packed(tmp_path, text), "'a.v'", "is in km/h, but in resources/CruiseControl.fmu it is in m/s")


def test_values_from_files_with_mappings_and_units(tmp_path):
    tonnes = '<ssv:Units><ssc:Unit name="t"><ssc:BaseUnit kg="1" factor="1000"/></ssc:Unit></ssv:Units>'
    set_ = values(tonnes, mass='<ssv:Real value="0.1" unit="t"/>', push=5.0, v0=1.0, other=3.0)
    mapping = f"""<ssm:ParameterMapping {SPACES} version="1.0"><ssm:MappingEntry source="mass" target="m"/>
        <ssm:MappingEntry source="push" target="force"><ssc:LinearTransformation factor="18" offset="10"/></ssm:MappingEntry>
        </ssm:ParameterMapping>"""
    files = {"resources/car.ssv": set_, "resources/car.ssm": mapping}
    binding = """<ssd:ParameterBinding source="resources/car.ssv"><ssd:ParameterMapping source="resources/car.ssm"/>
        </ssd:ParameterBinding>"""
    text = ssd(system(component("a", bindings=binding)))
    path = packed(tmp_path, text, **files)
    with pytest.warns(UserWarning, match="'other' of 'a', which does not exist; SSP requires to ignore it"):
        diagram = cosim.open_ssp(path, dt=H)
    assert diagram["a"].block.parameters == {"m": 100.0, "force": 100.0, "v0": 1.0}
    inner = f"<ssd:ParameterMapping>{mapping}</ssd:ParameterMapping>"
    again = inline(set_).replace("</ssd:ParameterValues>", "</ssd:ParameterValues>" + inner)
    path = packed(tmp_path, ssd(system(component("a", bindings=again))), name="inline.ssp")
    with pytest.warns(UserWarning, match="'other'"):
        assert cosim.open_ssp(path, dt=H)["a"].block.parameters == diagram["a"].block.parameters


def variable(name, reference, type, causality="parameter", variability="fixed"):
    attributes = f'name="{name}" valueReference="{reference}" causality="{causality}" variability="{variability}"'
    return f"<ScalarVariable {attributes}>{type}</ScalarVariable>"


MIXED = "\n".join(
    (
        variable("n", 20, '<Integer start="3"/>'),
        variable("on", 21, '<Boolean start="true"/>', variability="tunable"),
        variable("file", 22, '<String start="a"/>'),
        variable("gear", 23, '<Enumeration declaredType="Gear" start="1"/>'),
        variable("count", 24, '<Integer start="0"/>', "input", "discrete"),
        variable("step", 25, "<Integer/>", "output", "discrete"),
    )
)
GEAR = """<TypeDefinitions><SimpleType name="Gear"><Enumeration>
<Item name="first" value="1"/><Item name="back" value="-1"/></Enumeration></SimpleType></TypeDefinitions>"""


@pytest.fixture
def mixed(tmp_path):
    """An FMU whose description has variables of every type; its binary does not know them."""
    path = tmp_path / "mixed.fmu"
    with zipfile.ZipFile(CAR["2.0"]) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            content = old.read(name).decode("latin-1")
            if name == "modelDescription.xml":
                content = content.replace("<ModelVariables>", f"{GEAR}<ModelVariables>")
                if "<LogCategories" in content:  # which stand after the types
                    content = content.replace(GEAR, "").replace("<LogCategories", f"{GEAR}<LogCategories")
                content = content.replace("</ModelVariables>", f"{MIXED}</ModelVariables>")
                index = content.count("<ScalarVariable ")
                content = content.replace("</Outputs>", f'<Unknown index="{index}" dependencies=""/></Outputs>')
                content = content.replace(
                    "</InitialUnknowns>", f'<Unknown index="{index}" dependencies=""/></InitialUnknowns>'
                )
            new.writestr(name, content.encode("latin-1"))
    return path


def test_values_and_connections_of_every_type(tmp_path, mixed):
    typed = {
        "n": '<ssv:Integer value="7"/>',
        "on": '<ssv:Boolean value="0"/>',
        "file": '<ssv:String value="b &amp; c"/>',
        "gear": '<ssv:Enumeration value="back"/>',
    }
    a = component("a", source="mixed.fmu", bindings=inline(values(**typed)))
    b = component("b", source="mixed.fmu", connectors=connected("input", "count", type="<ssc:Integer/>"))
    path = packed(tmp_path, ssd(system(a + b, link("a.step", "b.count"))), **{"mixed.fmu": mixed.read_bytes()})
    diagram = cosim.open_ssp(path, dt=H)
    wanted = {"n": 7, "on": False, "file": "b & c", "gear": -1}
    assert diagram["a"].block.parameters == wanted
    assert [p.name for p in diagram["b"].block.inputs] == ["force", "disturbance", "count"]
    assert diagram.source_of(diagram["b"], diagram["b"]["count"].port, 0)[0].name == "a.step"
    text = described(cosim.save_ssp(diagram, tmp_path / "again.ssp"))
    assert '<ssv:Enumeration value="back" />' in text
    assert text.count("<ssc:Integer />") == 4
    assert cosim.open_ssp(tmp_path / "again.ssp")["a"].block.parameters == wanted
    held = cosim.Diagram(dt=H)
    c = held.add(cosim.FMU(mixed, tunable=["on"]), "c")
    for port, value in (("count", 3.0), ("on", 0.0)):
        held.connect(held.add(cosim.Constant(value), f"constant_{port}")["y"], c[port])
    opened = cosim.open_ssp(cosim.save_ssp(held, tmp_path / "held.ssp"))
    assert opened["c"].block.parameters == {"count": 3, "on": False}
    assert [p.name for p in opened["c"].block.inputs] == ["force", "disturbance", "count"]
    moved = cosim.Diagram(dt=H)
    c = moved.add(cosim.FMU(mixed, tunable=["on"]), "c")
    moved.connect(c["v"], c["on"])
    not_saved(moved, tmp_path / "none" / "moved.ssp", "c.on is a connected parameter")
    bad = component("a", source="mixed.fmu", bindings=inline(values(gear='<ssv:Enumeration value="third"/>')))
    path = packed(tmp_path, ssd(system(bad)), **{"mixed.fmu": mixed.read_bytes()})
    refused(path, "'gear'", "'first' (1)", error=cosim.FMUError)


def test_outer_and_later_values_win(tmp_path):
    own = inline(values(v0=5.0, m=1.0)) + inline(values(m=2.0, b=3.0))
    outer = inline(values(a__b=4.0)) + inline(values(v0=6.0), prefix="a.")
    inner = system(component("a", bindings=own), name="s", bindings=outer)
    text = ssd(system(inner, bindings=inline(values(s__a__b=7.0))))
    assert cosim.open_ssp(packed(tmp_path, text), dt=H)["s.a"].block.parameters == {"v0": 6.0, "m": 2.0, "b": 7.0}


def test_values_of_connectors_reach_the_components_behind_them(tmp_path):
    both = connected("parameter", "mass") + connected("input", "push")
    has = connected("parameter", "m") + connected("input", "force")
    double = '<ssc:LinearTransformation factor="2"/>'
    wires = link("mass", "a.m", double) + link("push", "a.force") + link("mass", "b.m")
    cars = component("a", connectors=has) + component("b", connectors=has)
    text = ssd(system(cars, wires, connectors=both, bindings=inline(values(mass=50.0, push=9.0, b__m=3.0))))
    diagram = cosim.open_ssp(packed(tmp_path, text), dt=H)
    assert diagram["a"].block.parameters == {"m": 100.0, "force": 9.0}
    assert diagram["b"].block.parameters["m"] == 3.0


def refused(path, *parts, error=SSPError, **options):
    options.setdefault("dt", H)
    with pytest.raises(error) as caught:
        cosim.open_ssp(path, **options)
    for part in parts:
        assert part in str(caught.value), str(caught.value)
    assert str(caught.value).endswith((".", "?"))
    assert caught.value.__cause__ is None


A, AB = component("a"), component("a") + component("b")
REFUSED = {
    "no component": (system(A).replace(A, ""), "breaks the rules of SSP"),
    "missing FMU": (
        system(component("a", source="resources/none.fmu")),
        "'a' of SystemStructure.ssd refers to none.fmu",
    ),
    "outside": (system(component("a", source="../../etc/passwd")), "only files beside it or in folders below"),
    "absolute": (system(component("a", source="file:///etc/passwd")), "only files beside it or in folders below"),
    "network": (system(component("a", source="https://localhost/car.fmu")), "only files beside it"),
    "same twice": (system(A + A), "two elements 'a' in one system"),
    "a system in a file": (system(component("a", type="application/x-ssp-package")), "only FMUs can be used"),
    "no such element": (system(AB, link("a.v", "c.disturbance")), "names an element that does not exist; known names"),
    "no such connector": (system(AB, link("a.v", "b.disturb")), "does not exist; did you mean 'disturbance'"),
    "no such variable": (
        system(component("a", connectors=connected("output", "w"))),
        "is no variable of resources/Cruise",
    ),
    "wrong kind": (
        system(component("a", connectors=connected("input", "v"))),
        "of kind input",
        "its causality is output",
    ),
    "two outputs": (system(AB, link("a.v", "b.v")), "joins two connectors that both give a value"),
    "two inputs": (system(AB, link("a.force", "b.force")), "both take a value; join an output and an input"),
    "two sources": (
        system(AB + component("c"), link("a.v", "c.force") + link("b.v", "c.force")),
        "c.force in SystemStructure.ssd has two connections that feed it",
    ),
    "a circle": (
        system(
            system(A, link("in", "out"), name="s", connectors=connected("input", "in") + connected("output", "out"))
            + component("b"),
            link("s.out", "s.in") + link("s.out", "b.force"),
        ),
        "form a cycle",
    ),
    "a mapping": (
        system(
            AB,
            link(
                "a.v",
                "b.force",
                '<ssc:IntegerMappingTransformation><ssc:MapEntry source="1" target="2"/></ssc:IntegerMappingTransformation>',
            ),
        ),
        "has the transformation IntegerMappingTransformation in the connection from a.v to b.force",
    ),
    "not finite": (
        system(AB, link("a.v", "b.force", '<ssc:LinearTransformation factor="INF"/>')),
        "a transformation of the connection from a.v to b.force that is not finite",
    ),
    "no value": (
        system(component("a", bindings=inline(values(m='<ssv:Real value="heavy"/>')))),
        "breaks the rules of SSP",
    ),
    "no such file": (
        system(component("a", bindings='<ssd:ParameterBinding source="none.ssv"/>')),
        "refers to 'none.ssv', which is not in the file",
    ),
    "schema": (
        system(A).replace("<ssd:Elements>", "<ssd:Elems/><ssd:Elements>"),
        "breaks the rules of SSP: line 1",
        "Elems",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(tmp_path, case):
    text, *words = REFUSED[case]
    refused(packed(tmp_path, ssd(text)), *words)


def test_wrong_values_are_the_fmus_to_refuse(tmp_path):
    bad = component("a", bindings=inline(values(m='<ssv:Boolean value="true"/>')))
    refused(packed(tmp_path, ssd(system(bad))), "'m' of the FMU", "a finite number, not True", error=cosim.FMUError)


def test_files_that_are_no_ssp(tmp_path):
    for function, arguments in ((cosim.open_ssp, (3,)), (cosim.save_ssp, (cosim.Diagram(dt=0.1), 3))):
        with pytest.raises(SSPError, match=rf"{function.__name__} has path=3; it must be the path of"):
            function(*arguments)
    with pytest.raises(SSPError, match="save_ssp has diagram=3; it must be a Diagram"):
        cosim.save_ssp(3, tmp_path / "none.ssp")
    refused(tmp_path / "none.ssp", "none.ssp cannot be read (No such file")
    refused(tmp_path / "none.ssd", "none.ssd cannot be read (No such file")
    (tmp_path / "text.ssp").write_text("no zip")
    refused(tmp_path / "text.ssp", "is no SSP: it is not a zip file")
    refused(CAR["2.0"], "is no SSP: it is a zip file without SystemStructure.ssd")
    refused(
        packed(tmp_path, ssd(system(A), version="3.0")),
        "is no SystemStructureDescription of SSP 1.0 or 2.0",
        "version 3.0",
    )
    refused(packed(tmp_path, "<html/>"), "it is <html>")
    path = packed(tmp_path, ssd(system(A)))
    refused(path, "has no 'other.ssd'; known names: SystemStructure.ssd", variant="other.ssd")


def test_hostile_files(tmp_path, cache):
    hostile = ssd(system(A)).replace("?>", '?><!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]>', 1)
    refused(packed(tmp_path, hostile), "SystemStructure.ssd", "document type declaration (DOCTYPE)")
    (tmp_path / "hostile.ssd").write_text(hostile)
    refused(tmp_path / "hostile.ssd", "document type declaration (DOCTYPE)")
    binding = '<ssd:ParameterBinding source="evil.ssv"/>'
    path = packed(tmp_path, ssd(system(component("a", bindings=binding))), **{"evil.ssv": "<!DOCTYPE x><x/>"})
    refused(path, "evil.ssv", "document type declaration (DOCTYPE)")
    assert not [p for p in cache.rglob("*") if p.name in {"SystemStructure.ssd", "evil.ssv"}]  # nothing was unpacked
    binding = '<ssd:ParameterBinding source="evil.txt"/>'  # read as XML, whatever it is called
    evil = '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><x>&e;</x>'
    path = packed(tmp_path, ssd(system(component("a", bindings=binding))), **{"evil.txt": evil})
    refused(path, "evil.txt", "document type declaration (DOCTYPE)")
    path = packed(tmp_path, ssd(system(A)), **{"../evil": "evil"})
    refused(path, "The SSP", "'../evil', which could be unpacked outside its folder; nothing was unpacked")
    unpacked = [p.name for p in cache.rglob("*") if p.suffix in {".fmu", ".ssd"}] if cache.exists() else []
    assert set(unpacked) <= {"SystemStructure.ssd", *(c.name for c in CAR.values())}
    with pytest.raises(SSPError):
        _zip.check(path, SSP_FILE)
    with zipfile.ZipFile(tmp_path / "evil.fmu", "w") as archive:
        archive.writestr("../evil", "evil")
    evil = ssd(system(component("a", source="evil.fmu")))
    path = packed(tmp_path, evil, **{"evil.fmu": (tmp_path / "evil.fmu").read_bytes()})
    refused(path, "evil.fmu has an entry called '../evil'", error=cosim.FMUError)


@settings(max_examples=75, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_structure_ends_in_a_sentence(tmp_path_factory, data):
    """Values of attributes are put in each other's place; what is not validated is read all the same."""
    inner = system(component("b"), link("in", "b.disturbance"), name="s", connectors=middle("km/h"))
    wire = link("a.v", "s.in", '<ssc:LinearTransformation factor="2" offset="3"/>', suppressUnitConversion="false")
    text = ssd(system(component("a", bindings=START) + inner, wire, bindings=inline(values(s__b__m=9.0))), UNITS)
    pieces = re.findall(r'"[^"]*"|[^"]+', text)
    places = [i for i, piece in enumerate(pieces) if piece.startswith('"')]
    strange = ['"NaN"', '""', '"-1"', '"../x"', '"output"', '"calculatedParameter"']
    for _ in range(data.draw(st.integers(1, 3))):
        pieces[data.draw(st.sampled_from(places))] = data.draw(
            st.sampled_from([*strange, *(pieces[i] for i in places)])
        )
    path = packed(tmp_path_factory.mktemp("strange"), "".join(pieces))
    with suppress(cosim.BayesFTCError), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of values for what does not exist
        cosim.open_ssp(path, dt=H, validate=data.draw(st.booleans()))


def two_cars(dt="1/50", fmi=("2.0", "2.0"), build=None):
    diagram = cosim.Diagram(dt=dt)
    a = diagram.add(cosim.FMU(CAR[fmi[0]], parameters={"v0": 1.0, "force": 100.0}), "a")
    b = diagram.add(cosim.FMU(CAR[fmi[1]], parameters={"m": 120.0}), "b")
    gain = diagram.add(cosim.Gain(0.01, offset=0.002), "gain")
    push = diagram.add(cosim.Constant(3.0), "push")
    diagram.connect(a["v"], gain["u"])
    diagram.connect(gain["y"], b["disturbance"])
    diagram.connect(push["y"], b["force"])
    diagram.connect(b["v"], a["disturbance"])
    return diagram.build(build) if build else diagram


@pytest.mark.parametrize("coupling", ["jacobi", "gauss-seidel"])
@pytest.mark.parametrize("fmi", [("2.0", "2.0"), ("2.0", "3.0")])
def test_round_trip(tmp_path, coupling, fmi, same_bits):
    path = cosim.save_ssp(two_cars("1/30", fmi), tmp_path / "two.ssp")
    opened = cosim.open_ssp(path)
    assert opened.step == two_cars("1/30").step
    wanted = two_cars("1/30", fmi).build(coupling).simulate(2.0, engine="interpreted")
    result = opened.build(coupling).simulate(2.0, engine="interpreted")
    for name in ("a.v", "b.v"):
        same_bits(result[name], wanted[name], name)
    again = cosim.save_ssp(cosim.open_ssp(path), tmp_path / "again.ssp")
    assert described(again) == described(path).replace('name="two"', 'name="again"')
    copy = pickle.loads(pickle.dumps(cosim.open_ssp(path))).build(coupling).simulate(2.0, engine="interpreted")
    same_bits(copy["b.v"], wanted["b.v"])


def described(path):
    with zipfile.ZipFile(path) as archive:
        return archive.read("SystemStructure.ssd").decode()


def test_the_same_diagram_gives_the_same_bytes(tmp_path):
    first = cosim.save_ssp(two_cars(), tmp_path / "two.ssp").read_bytes()
    assert cosim.save_ssp(two_cars(), tmp_path / "two.ssp").read_bytes() == first
    assert [p.name for p in tmp_path.iterdir() if p.name != "cache"] == ["two.ssp"]


def test_another_reader_finds_it_in_order(tmp_path):
    from fmpy.ssp.ssd import read_ssd

    system = read_ssd(str(cosim.save_ssp(two_cars(), tmp_path / "two.ssp")), validate=True).system
    assert [(c.name, c.source) for c in system.elements] == [(n, "resources/CruiseControl.fmu") for n in "ab"]
    assert [(c.startElement, c.endElement, c.endConnector) for c in system.connections] == [
        ("b", "a", "disturbance"),
        ("a", "b", "disturbance"),
    ]


@pytest.mark.slow
def test_inspect_shows_components_values_and_connections(tmp_path):
    path = cosim.save_ssp(two_cars(), tmp_path / "two.ssp")
    command = [sys.executable, "-m", "bayesftc", "inspect", str(path)]
    text = subprocess.run(
        command, capture_output=True, text=True, check=True, env={**os.environ, "COLUMNS": "120"}
    ).stdout
    for words in ("step  1/50 s", "v0 = 1.0, force = 100.0", "co-simulation", "b.disturbance", "0.01", "0.002"):
        assert words in text
    found = json.loads(subprocess.run([*command, "--json"], capture_output=True, text=True, check=True).stdout)
    assert found["connections"][1] == {"from": "a.v", "to": "b.disturbance", "factor": 0.01, "offset": 0.002}
    assert found["components"]["b"]["values"] == {"m": 120.0, "force": 3.0}


def test_files_of_one_name(tmp_path):
    diagram = cosim.Diagram(dt=H)
    for i, fmi in enumerate(CAR):
        (tmp_path / fmi).mkdir()
        file = tmp_path / fmi / "car.fmu"
        file.write_bytes(CAR[fmi].read_bytes())
        diagram.add(cosim.FMU(file), f"car{i}")
        diagram.add(cosim.FMU(CAR[fmi]), f"again{i}")
    path = cosim.save_ssp(diagram, tmp_path / "cars.ssp")
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    wanted = ["CruiseControl.fmu", "CruiseControl_fmi3.fmu", "car.fmu", "car_2.fmu"]
    assert names == ["SystemStructure.ssd", *(f"resources/{name}" for name in wanted)]
    versions = [cosim.open_ssp(path)[name].block.description.fmi_version for name in ("car0", "car1")]
    assert versions == ["2.0", "3.0"]


def test_rows_of_a_matrix_and_gains_in_a_row(tmp_path):
    diagram = cosim.Diagram(dt=H)
    a, b = (diagram.add(cosim.FMU(CAR["2.0"], parameters={"v0": v}), n) for n, v in (("a", 1.0), ("b", 2.0)))
    swap = diagram.add(cosim.Gain([[0.0, 3.0], [0.0, 0.0]], offset=0.5), "swap")
    half = diagram.add(cosim.Gain(0.5, offset=1.0), "half")
    diagram.connect([a["v"], b["v"]], swap["u"])
    diagram.connect(swap["y"][0], half["u"])
    diagram.connect(half["y"], a["disturbance"])
    diagram.connect(swap["y"][1], b["force"])
    text = described(cosim.save_ssp(diagram, tmp_path / "x.ssp"))
    assert '<ssc:LinearTransformation factor="1.5" offset="1.25"' in text
    opened = cosim.open_ssp(tmp_path / "x.ssp")
    assert opened["b"].block.parameters == {"v0": 2.0, "force": 0.5}
    wanted, result = (d.build("jacobi").simulate(1.0, engine="interpreted") for d in (diagram, opened))
    np.testing.assert_allclose(result["a.v"], wanted["a.v"], rtol=1e-13)


def not_saved(diagram, path, *parts):
    with pytest.raises(SSPError) as caught:
        cosim.save_ssp(diagram, path)
    for part in parts:
        assert part in str(caught.value)
    assert not list(path.parent.glob("*.ssp"))
    assert not list(path.parent.glob(".*tmp"))


def test_what_cannot_be_saved(tmp_path):
    path = tmp_path / "x.ssp"
    not_saved(cosim.Diagram(dt=H), path, "The diagram has no FMU")
    not_saved(two_cars(), tmp_path / "x.zip", "is no name for an SSP; it must end in .ssp")
    not_saved(two_cars(), tmp_path / "none" / "x.ssp", "cannot be written", "choose another folder")
    diagram = two_cars()
    diagram.add(cosim.UnitDelay(), "delay")
    not_saved(diagram, path, "'delay' (UnitDelay) has no equivalent in SSP", "Replace it by an FMU")
    diagram = two_cars()
    diagram.add(cosim.FMU(CAR["2.0"]), "slow", every=2)
    not_saved(diagram, path, "'slow' runs with every=2")
    diagram = two_cars()
    diagram.add(cosim.FMU(CAR["2.0"], timing="sampled"), "late")
    not_saved(diagram, path, "'late' makes its step before its outputs are used (timing='sampled')")
    diagram = two_cars()
    diagram.add(cosim.Gain(1.0), "lost")
    not_saved(diagram, path, "'lost' feeds no FMU and would be lost")
    diagram = cosim.Diagram(dt=H)
    a = diagram.add(cosim.FMU(CAR["2.0"]), "a")
    sum_ = diagram.add(cosim.Gain([[1.0, 2.0]]), "sum")
    b = diagram.add(cosim.FMU(CAR["2.0"]), "b")
    diagram.connect([a["v"], b["v"]], sum_["u"])
    diagram.connect(sum_["y"], a["force"])
    not_saved(diagram, path, "'sum' adds signals on the way to a.force")


@pytest.mark.parametrize("fmi", [("2.0", "2.0"), ("2.0", "3.0")])
def test_another_tool_gives_the_same_bits(tmp_path, ecos, same_bits, fmi):
    path = cosim.save_ssp(two_cars(fmi=fmi), tmp_path / "two.ssp")
    ours = cosim.open_ssp(path).build("jacobi").simulate(2.0, engine="interpreted")
    theirs = {"a.v": [], "b.v": []}
    with ecos.EcosSimulation(ssp_path=str(path), step_size=H) as simulation:
        simulation.init(parameter_set="initialValues")
        for _ in range(101):
            for name, rows in theirs.items():
                rows.append(simulation.get_real(name.replace(".", "::")))
            simulation.step()
    assert abs(ours["b.v"]).max() > 0.1
    for name, rows in theirs.items():
        same_bits(ours[name], np.array(rows), name)
