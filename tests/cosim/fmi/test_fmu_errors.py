"""FMUs that cannot be used: each is refused with a sentence that says what, where and what to do."""

import os
import subprocess
import sys
import zipfile
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from bayesftc import cosim, fmus
from bayesftc.cosim.base import archives as _zip
from bayesftc.cosim.errors import FMUError, ModelError, StepSizeError, UnknownNameError
from bayesftc.cosim.fmi.binaries import library as _fmi_library
from bayesftc.cosim.fmi.fmu import FMU, describe
from bayesftc.cosim.fmi.reading import archive as _fmi_archive

STEP = Fraction(1, 50)
SHIPPED = {fmi: fmus.path("CruiseControl", fmi=fmi) for fmi in ("2.0", "3.0")}


NEEDY = '<CoSimulation needsExecutionTool="true" '


def _fmi2(name, reference, causality, variability, value):
    attributes = f'name="{name}" valueReference="{reference}" causality="{causality}" variability="{variability}"'
    return f"<ScalarVariable {attributes}>{value}</ScalarVariable>"


EXTRA = {
    "2.0": _fmi2("n", 20, "parameter", "fixed", '<Integer start="3"/>')
    + _fmi2("on", 21, "parameter", "tunable", '<Boolean start="true"/>')
    + _fmi2("file", 22, "parameter", "fixed", '<String start="a"/>')
    + _fmi2("count", 23, "input", "discrete", '<Integer start="0"/>')
    + _fmi2("label", 25, "input", "discrete", '<String start="a"/>')
    + _fmi2("pi", 24, "local", "constant", '<Real start="3.14"/>'),
    "3.0": """
      <Int8 name="n" valueReference="20" causality="parameter" variability="fixed" start="3"/>
      <Boolean name="on" valueReference="21" causality="parameter" variability="tunable" start="true"/>
      <String name="file" valueReference="22" causality="parameter" variability="fixed"><Start value="a"/></String>
      <String name="label" valueReference="27" causality="input" variability="discrete"><Start value="a"/></String>
      <Int32 name="count" valueReference="23" causality="input" variability="discrete" start="0"/>
      <Float64 name="pi" valueReference="24" causality="local" variability="constant" start="3.14"/>
      <Float64 name="wide" valueReference="25" causality="input" start="1 2 3"><Dimension start="3"/></Float64>
      <Float64 name="gains" valueReference="26" causality="parameter" variability="fixed" start="1 2">
        <Dimension start="2"/>
      </Float64>
    """,
}


def edited(source, target, change=None, **files):
    """Copy an FMU; `change` edits the model description, `files` replaces entries by their suffix (None drops them)."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            content, kind = old.read(name), Path(name).suffix[1:]
            if name == "modelDescription.xml" and change:
                content = change(content.decode()).encode()
            content = files.get(kind, content)
            if content is not None:
                new.writestr(name, content)
    return target


def replaced(fmi, target, old, new):
    def change(text):
        assert old in text
        return text.replace(old, new)

    return edited(SHIPPED[fmi], target, change)


def with_extra(fmi, folder):
    return replaced(fmi, folder / f"extra{fmi[0]}.fmu", "</ModelVariables>", EXTRA[fmi] + "</ModelVariables>")


def refused(build, *parts, error=FMUError):
    """Check that `build` raises a sentence with these parts, and that nothing of fmpy shows."""
    with pytest.raises(error) as caught:
        build()
    text = str(caught.value)
    for part in parts:
        assert part in text
    assert text[-1] in ".?"
    assert caught.value.__cause__ is None
    assert caught.value.__suppress_context__ or caught.value.__context__ is None


def test_files_that_are_no_fmu(tmp_path):
    refused(lambda: FMU(tmp_path / "none.fmu"), "none.fmu cannot be read (No such file", "check the path")
    refused(lambda: FMU(tmp_path), "is a folder; give the .fmu file")
    text = tmp_path / "text.fmu"
    text.write_text("not a zip")
    refused(lambda: FMU(text), "is no FMU: it is not a zip file, or it is damaged")
    empty = tmp_path / "empty.fmu"
    with zipfile.ZipFile(empty, "w") as archive:
        archive.writestr("readme.txt", "nothing here")
    refused(lambda: FMU(empty), "without modelDescription.xml at its top")
    refused(lambda: describe(empty), "without modelDescription.xml at its top")


@pytest.mark.parametrize("keep", [10, 1000, 20_000, -100])
def test_truncated_files(tmp_path, keep):
    short = tmp_path / "short.fmu"
    short.write_bytes(SHIPPED["2.0"].read_bytes()[:keep])
    refused(lambda: FMU(short), "it is damaged", "get or export the file again")


def test_damage_inside_the_zip(tmp_path):
    with zipfile.ZipFile(SHIPPED["2.0"]) as archive:
        offset = {i.filename: i.header_offset + 30 + len(i.filename) for i in archive.infolist()}
    for name, sentence in (("modelDescription.xml", "is damaged"), ("binaries/linux64/CruiseControl.so", "is damaged")):
        if name not in offset:
            pytest.skip("looks for the binary of another platform")
        content = bytearray(SHIPPED["2.0"].read_bytes())
        for i in range(40):
            content[offset[name] + 200 + i] ^= 0xFF
        broken = tmp_path / f"{Path(name).stem}.fmu"
        broken.write_bytes(content)
        refused(lambda path=broken: FMU(path).instantiate(STEP, "car"), sentence, "get or export the file again")


@pytest.mark.parametrize("name", ["../evil.txt", "/etc/evil", "binaries/../../evil", "C:/evil", "a\\..\\evil"])
def test_entries_that_leave_the_folder(tmp_path, name):
    path = edited(SHIPPED["2.0"], tmp_path / "evil.fmu")
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(zipfile.ZipInfo(name), "evil")
    refused(lambda: FMU(path), repr(name), "could be unpacked outside its folder; nothing was unpacked")


@pytest.mark.parametrize("version", ["2.1", "4.0", ""])
def test_other_versions(tmp_path, version):
    path = replaced("2.0", tmp_path / "old.fmu", 'fmiVersion="2.0"', f'fmiVersion="{version}"')
    wanted = f"is an FMU of FMI {version}" if version else "without a version"
    refused(lambda: FMU(path), wanted, "only FMI 1.0, 2.0 and 3.0 can be used")
    refused(lambda: describe(path), wanted)


def test_kinds(tmp_path):
    def change(text):
        begin, end = text.index("<CoSimulation"), text.index("</CoSimulation>") + len("</CoSimulation>")
        return text[:begin] + '<ModelExchange modelIdentifier="CruiseControl"/>' + text[end:]

    path = edited(SHIPPED["2.0"], tmp_path / "me.fmu", change)
    refused(lambda: FMU(path, kind="co-simulation"), "cannot be used for co-simulation, only for model exchange")
    assert FMU(path).kind == "model exchange"
    assert describe(path).kinds == ("modelExchange",)
    refused(lambda: FMU(SHIPPED["2.0"], kind="model exchange"), "only for co-simulation. Leave kind= out")
    refused(lambda: FMU(SHIPPED["2.0"], kind="ME"), "'co-simulation' or 'model exchange'", error=ModelError)
    refused(lambda: FMU(SHIPPED["2.0"], atol=1e-4), "atol=0.0001", "brings its own solver", error=ModelError)
    refused(lambda: FMU(SHIPPED["2.0"], rtol=-1e-4), "rtol=-0.0001", "positive number", error=ModelError)
    refused(lambda: FMU(SHIPPED["2.0"], rtol=1.0), "rtol=1.0", "below 1", error=ModelError)
    refused(lambda: FMU(SHIPPED["2.0"], timing="direct"), "cannot show inputs of the same", error=ModelError)

    def scheduled(text):
        begin, end = text.index("<CoSimulation"), text.index("/>", text.index("<CoSimulation")) + 2
        return text[:begin] + '<ScheduledExecution modelIdentifier="CruiseControl"/>' + text[end:]

    path = edited(SHIPPED["3.0"], tmp_path / "se.fmu", scheduled)
    refused(lambda: FMU(path), "supports scheduled execution only", "Export it for co-simulation or model exchange")


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_no_binary_for_this_platform(tmp_path, fmi):
    import fmpy

    here = fmpy.platform if fmi == "2.0" else fmpy.platform_tuple
    path = tmp_path / "elsewhere.fmu"
    with zipfile.ZipFile(SHIPPED[fmi]) as old, zipfile.ZipFile(path, "w") as new:
        for name in (n for n in old.namelist() if n == "modelDescription.xml" or f"/{here}/" in n):
            new.writestr(name.replace(f"binaries/{here}/", "binaries/riscv64-plan9/"), old.read(name))
    assert describe(path).platforms == ("riscv64-plan9",)
    refused(lambda: FMU(path).instantiate(STEP, "car"), f"no binary for this platform, {here} (it has: riscv64-plan9)")
    bare = edited(SHIPPED[fmi], tmp_path / "bare.fmu", so=None, dll=None, dylib=None, c=None)
    refused(lambda: FMU(bare).instantiate(STEP, "car"), "(it has: no binaries at all), and no C sources that can be")


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_a_binary_of_another_name(tmp_path, fmi, caplog, bayesftc_):
    import fmpy

    here, suffix = fmpy.platform if fmi == "2.0" else fmpy.platform_tuple, fmpy.sharedLibraryExtension
    own = f"binaries/{here}/CruiseControl{suffix}"

    def renamed(*names):
        path = tmp_path / f"renamed{len(names)}.fmu"
        with zipfile.ZipFile(SHIPPED[fmi]) as old, zipfile.ZipFile(path, "w") as new:
            for name in (n for n in old.namelist() if not n.startswith("sources/") and n != own):
                new.writestr(name, old.read(name))
            for name in names:
                new.writestr(f"binaries/{here}/{name}", old.read(own))
        return path

    path = renamed(f"car{suffix}")
    diagram = cosim.Diagram(dt=0.02)
    diagram.add(FMU(path, parameters={"v0": 3.0}), "car")
    said = f"is named car{suffix} instead of CruiseControl{suffix} (modelIdentifier), but is the only one"
    assert diagram.simulate(0.1, engine="interpreted")["car.v"][0] == 3.0
    assert f"The binary of the FMU renamed1.fmu for {here} {said}, and is used." in caplog.text
    assert said in " ".join(bayesftc_("inspect", path, "--json").output.split())
    several = renamed(f"a{suffix}", f"b{suffix}")
    there = f"has no binary CruiseControl{suffix} for this platform, {here} (but a{suffix} and b{suffix} there)"
    refused(lambda: FMU(several).instantiate(STEP, "car"), there)
    refused(lambda: FMU(renamed("readme.txt", "b.md", "c.md")).instantiate(STEP, "car"), "(but no binary at all there)")


def test_invalid_descriptions(tmp_path):
    path = replaced("2.0", tmp_path / "invalid.fmu", 'variability="', 'variability="un')
    refused(
        lambda: FMU(path), "breaks the rules of FMI", "'uncontinuous'", "; and 3 more. Ask its maker", "validate=False"
    )
    twice = replaced("2.0", tmp_path / "twice.fmu", 'name="v0"', 'name="m"')
    refused(lambda: FMU(twice), 'The variable name "m" (line', "is not unique")
    refused(lambda: describe(twice), "is not unique")
    assert FMU(twice, validate=False).outputs[0].name == "v"
    broken = replaced("2.0", tmp_path / "broken.fmu", "</ModelStructure>", "")
    refused(lambda: FMU(broken), "modelDescription.xml", "is damaged (mismatched tag")
    typo = replaced("2.0", tmp_path / "start.fmu", 'start="5.0"', 'start="five"')
    refused(lambda: FMU(typo, validate=False), "'b'", "the start value 'five', which is no valid Real")


ORDER = '<Annotations><Annotation type="someone" order="3"/></Annotations>'
TEXT = '<String name="file" valueReference="22" causality="parameter" variability="fixed" start="a"/></ModelVariables>'


def in_b(*children):
    """Return the end of a variable of FMI 3, without and with elements inside."""
    return ' unit="N.s/m" start="5.0" />', f' unit="N.s/m" start="5.0">{"".join(children)}</Float64>'


HARMLESS = {
    "another attribute of the model": ("2.0", 'modelName="', 'vendor="someone" modelName="', "attribute 'vendor'"),
    "no start value": ("2.0", ' start="5.0"', "", "has no start value"),
    "annotations with an attribute": ("3.0", *in_b("", ORDER), "attribute 'order'"),
    "annotations after an alias": ("3.0", *in_b('<Alias name="drag"/>', ORDER), "Element 'Annotations'"),
    "a text with a start value as an attribute": (
        "3.0",
        "</ModelVariables>",
        TEXT,
        "Element 'String', attribute 'start'",
    ),
}
HARMFUL = {
    "an element that nobody knows": ("<ModelVariables>", "<Vendor/><ModelVariables>", "'Vendor'"),
    "a start value that is misspelt": (' start="5.0"', ' strat="5.0"', "'strat'"),
    "a causality that is misspelt": ('causality="input"', 'causalty="input"', "'causalty'"),
    "a capability that is misspelt": ("canGetAndSetFMUstate", "canGetAndSetState", "'canGetAndSetState'"),
}
HIDDEN = in_b('<Alias name="drag"/>', ORDER, '<Alais name="friction"/>')  # the schema check stops at the annotations


@pytest.mark.parametrize("way", HARMFUL)
def test_descriptions_that_may_mean_something_else_are_refused(tmp_path, way):
    before, after, words = HARMFUL[way]
    refused(lambda: FMU(replaced("2.0", tmp_path / "typo.fmu", before, after)), "breaks the rules of FMI", words)


def test_annotations_in_the_wrong_place_hide_nothing(tmp_path):
    path = replaced("3.0", tmp_path / "typo.fmu", *HIDDEN)
    refused(lambda: FMU(path), "breaks the rules of FMI", "Element 'Alais'")


@pytest.mark.parametrize("way", HARMLESS)
def test_descriptions_that_break_rules_on_which_nothing_hangs(tmp_path, way):
    fmi, before, after, words = HARMLESS[way]
    path = replaced(fmi, tmp_path / "lax.fmu", before, after)
    with pytest.warns(UserWarning, match="but this does not affect results") as caught:
        block = FMU(path, parameters={"b": 5.0, "force": 100.0})
    assert words in str(caught[0].message)
    assert caught[0].filename == __file__
    with pytest.warns(UserWarning, match="does not affect results"):  # each time
        describe(path)
    diagram, usual = cosim.Diagram(dt=0.02), cosim.Diagram(dt=0.02)
    diagram.add(block, "car")
    usual.add(FMU(SHIPPED[fmi], parameters={"force": 100.0}), "car")
    np.testing.assert_array_equal(diagram.simulate(1.0)["car.v"], usual.simulate(1.0)["car.v"])
    both = replaced(fmi, tmp_path / "both.fmu", 'name="v0"', 'name="m"')
    both = edited(both, tmp_path / "two.fmu", lambda text: text.replace(before, after))
    refused(lambda: FMU(both), 'The variable name "m" (line', "is not unique")  # which is looked at after the schema


def test_binaries_that_cannot_be_loaded(tmp_path):
    import fmpy

    here = os.getcwd()
    garbage = b"\x7fELF, but no more"
    path = edited(SHIPPED["2.0"], tmp_path / "garbage.fmu", so=garbage, dll=garbage, dylib=garbage)
    refused(
        lambda: FMU(path).instantiate(STEP, "car"), "cannot be loaded: ", "<fmu>/binaries", "libraries that it needs"
    )
    assert os.getcwd() == here  # fmpy would leave us in the binary's folder
    with zipfile.ZipFile(SHIPPED["2.0"]) as two, zipfile.ZipFile(SHIPPED["3.0"]) as three:
        name = next(n for n in two.namelist() if n.startswith(f"binaries/{fmpy.platform}/"))
        other = next(n for n in three.namelist() if n.startswith(f"binaries/{fmpy.platform_tuple}/"))
        wrong = edited(SHIPPED["2.0"], tmp_path / "wrong.fmu", **{Path(name).suffix[1:]: three.read(other)})
    refused(
        lambda: FMU(wrong).instantiate(STEP, "car"),
        "cannot be loaded: it lacks 34 functions: fmi2CancelStep, fmi2DeSerializeFMUstate, fmi2DoStep, ",
        " and 29 more. FMI 2.0 requires all, even if they only return an error. ",
        "complete binary",
    )


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_refused_instantiation_and_initialization(tmp_path, fmi):
    token = describe(SHIPPED[fmi]).token
    path = replaced(fmi, tmp_path / "token.fmu", token, "{00000000-0000-0000-0000-000000000000}")
    refused(
        lambda: FMU(path).instantiate(STEP, "car"),
        "The FMU 'CruiseControl' could not be instantiated as 'car'. If it needs a tool or a licence, check that it is "
        "available. Its log: Instantiation: the token",
    )
    needy = edited(path, tmp_path / "needy.fmu", lambda text: text.replace("<CoSimulation ", NEEDY))
    refused(lambda: FMU(needy).instantiate(STEP, "car"), "to run (needsExecutionTool): install it here, or export")
    path = replaced(fmi, tmp_path / "reference.fmu", 'valueReference="3"', 'valueReference="77"')
    diagram_block = FMU(path, parameters={"b": 6.0})
    real = "fmi2SetReal" if fmi == "2.0" else "fmi3SetFloat64"
    refused(
        lambda: diagram_block.instantiate(STEP, "car"),
        f"could not be initialized as 'car': {real} of 'b' returned Error. Check its parameters and start values. Its log: ",
        "value reference 77",
    )
    FMU(SHIPPED[fmi]).instantiate(STEP, "car").close()  # the failures have left nothing in the way


def test_only_once_per_process(tmp_path):
    path = replaced("2.0", tmp_path / "once.fmu", 'OnlyOncePerProcess="false"', 'OnlyOncePerProcess="true"')
    first = FMU(path).instantiate(STEP, "first")
    refused(
        lambda: FMU(path).instantiate(STEP, "second"), "'second' cannot be a second instance", "one after the other"
    )
    first.close()
    FMU(path).instantiate(STEP, "second").close()


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_names_and_types(tmp_path, fmi):
    path = with_extra(fmi, tmp_path)
    block = FMU(path)
    assert [p.name for p in block.inputs] == ["force", "disturbance", "count", *(["wide"] if fmi == "3.0" else [])]
    good = FMU(path, parameters={"n": 7, "on": False, "file": "b", "count": 2, "m": 3})
    assert good.parameters == {"n": 7, "on": False, "file": "b", "count": 2, "m": 3.0}
    refused(
        lambda: FMU(path, parameters={"disturb": 1.0}),
        "has no variable 'disturb'; did you mean 'disturbance'",
        error=UnknownNameError,
    )
    refused(
        lambda: FMU(path, parameters={"v": 1.0}),
        "'v' of the FMU",
        "cannot be set: it is an output that the FMU computes",
    )
    refused(lambda: FMU(path, parameters={"pi": 3.0}), "cannot be set: it is a local", "(constant)")
    for name, value, wanted in (
        ("m", "heavy", "must be a finite number, not 'heavy'"),
        ("m", True, "a finite number, not True"),
        ("m", float("nan"), "a finite number, not nan"),
        ("n", 2.5, "a whole number from "),
        ("n", 2**40, "a whole number from "),
        ("on", 1, "True or False, not 1"),
        ("file", 3, "a string, not 3"),
        ("file", "a\0b", "a string without NUL characters or surrogates, not 'a"),
        ("file", "\ud800", "a string without NUL characters or surrogates, not "),
    ):
        refused(lambda n=name, v=value: FMU(path, parameters={n: v}), f"{name!r} of the FMU", wanted)
    refused(lambda: FMU(path, inputs=["frce"]), "has no input 'frce'; did you mean 'force'", error=UnknownNameError)
    refused(lambda: FMU(path, inputs=["v"]), "has no input 'v'; it is of causality output.", error=UnknownNameError)
    refused(lambda: FMU(path, outputs=["force"]), "has no output 'force'", error=UnknownNameError)
    refused(lambda: FMU(path, inputs=["label"]), "is of type String; only numbers can be ports")
    refused(lambda: FMU(path, inputs="force"), "give a list of names, as ['force']", error=ModelError)
    refused(lambda: FMU(path, inputs=["force", "force"]), "'force' twice in inputs", error=ModelError)
    refused(lambda: FMU(3), "FMU has path=3; it must be the path of an .fmu file", error=ModelError)
    refused(lambda: FMU(path, parameters=["m"]), "parameters=['m']; give values by name", error=ModelError)
    refused(lambda: FMU(path, validate="no"), "validate='no'; it must be True or False", error=ModelError)
    refused(lambda: FMU(path, timing="fast"), "it must be 'plant', 'direct' or 'sampled'", error=ModelError)
    if fmi == "3.0":
        assert FMU(path).port("wide").default == (1.0, 2.0, 3.0)
        for gains in (1.0, [1.0], [[1.0, 2.0]], [1.0, 2.0, 3.0], "1 2"):
            refused(lambda g=gains: FMU(path, parameters={"gains": g}), "'gains'", "Give it row by row", error=FMUError)


@pytest.mark.parametrize(("library", "prefix"), [(_fmi_library.Library2, "fmi2"), (_fmi_library.Library3, "fmi3")])
def test_values_of_every_type_reach_the_right_function(tmp_path, library, prefix):
    fmi = "2.0" if prefix == "fmi2" else "3.0"
    calls = []

    class Slave:
        def __getattr__(self, function):
            def call(component, references, count, values, *more):
                calls.append((function, component, list(references), count, values[0], *more))

            return call

    description = describe(with_extra(fmi, tmp_path))
    v = {variable.name: variable for variable in description.variables}
    values = {v["m"]: 2.0, v["n"]: -7, v["on"]: True, v["file"]: "b\N{LATIN SMALL LETTER E WITH ACUTE}"}
    library(description, Slave(), None).set_values(9, values)
    names = ("Real", "Integer", "Boolean", "String") if fmi == "2.0" else ("Float64", "Int8", "Boolean", "String")
    wanted = zip(names, (4, 20, 21, 22), (2.0, -7, True, "b\xe9".encode()), strict=True)
    more = () if fmi == "2.0" else (1,)
    assert calls == [(f"{prefix}Set{name}", 9, [reference], 1, value, *more) for name, reference, value in wanted]


TOO_LARGE = {
    "huge": 10**400,
    "thousands": 10**5000,
    "digits": "9" * 100_000,
    "nan": float("nan"),
    "scaled": (1e300, "Yg"),
}


@pytest.mark.parametrize("value", TOO_LARGE.values(), ids=TOO_LARGE)
def test_numbers_that_no_double_holds(value):
    diagram = cosim.Diagram(dt=0.02)
    diagram.add(FMU(fmus.path("CruiseControl")), "car")
    with pytest.raises(FMUError, match="must be a finite number, not") as caught:
        FMU(fmus.path("CruiseControl"), parameters={"m": value})
    assert len(str(caught.value)) < 200
    if isinstance(value, int | str):
        with pytest.raises(ModelError, match="it must be a finite number"):
            cosim.Constant(value)
        with pytest.raises(StepSizeError) as caught:
            cosim.Diagram(dt=value)
        assert len(str(caught.value)) < 200
        with pytest.raises(StepSizeError):
            diagram.simulate(value)
        with diagram.start(engine="interpreted") as session, pytest.raises(ModelError, match="cannot be set to"):
            session.set("car.force", value)


def test_a_file_that_changes_under_a_block(tmp_path):
    path = tmp_path / "car.fmu"
    path.write_bytes(SHIPPED["2.0"].read_bytes())
    block = FMU(path, parameters={"v0": 1.0})
    replaced("2.0", path, 'name="v0"', 'name="start_speed"')
    os.utime(path, ns=(1, 1))
    refused(lambda: block.instantiate(STEP, "car"), "has changed since it was read and no longer has 'v0'")


def test_unpacking_happens_once_and_mends_itself(tmp_path, monkeypatch):
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "cache"))
    archive = _fmi_archive.open_archive(SHIPPED["2.0"])
    entry = next(n for n in archive.names if n.startswith("binaries/"))
    folder = _fmi_archive.extract(archive, entry)
    assert folder == tmp_path / "cache" / "fmus" / archive.digest
    stamp = (folder / entry).stat().st_mtime_ns
    assert _fmi_archive.extract(archive, entry) == folder
    assert (folder / entry).stat().st_mtime_ns == stamp
    assert {p.name for p in folder.parent.iterdir()} <= {archive.digest, f"{archive.digest}.lock"}
    (folder / entry).unlink()
    _fmi_archive.extract(archive, entry)
    assert (folder / entry).stat().st_size > 1000


@pytest.mark.slow
def test_many_processes_unpack_one_fmu(tmp_path):
    code = (
        "from bayesftc.cosim.fmi.reading import archive as a; import sys; from pathlib import Path; "
        "f = a.open_archive(Path(sys.argv[1])); print(a.extract(f, 'modelDescription.xml'))"
    )
    environment = {**os.environ, "BAYESFTC_CACHE": str(tmp_path)}
    command = [sys.executable, "-c", code, str(SHIPPED["3.0"])]
    running = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(4)]
    answers = {process.communicate(timeout=60)[0] for process in running}
    assert [process.returncode for process in running] == [0] * 4
    assert len(answers) == 1
    assert len([p for p in (tmp_path / "fmus").iterdir() if p.is_dir()]) == 1


def test_no_room_to_unpack(tmp_path, monkeypatch):
    def full(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path))
    monkeypatch.setattr(_zip, "unpack", full)
    archive = _fmi_archive.open_archive(SHIPPED["2.0"])
    refused(lambda: _fmi_archive.extract(archive, archive.names[0]), "No space left on device", "BAYESFTC_CACHE")
    assert not [p for p in (tmp_path / "fmus").iterdir() if p.is_dir()]  # nothing half-done is left
