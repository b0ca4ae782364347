"""SSPs as other tools write them: their annotations, connectors, parameter files, and what they write against the rules."""

import subprocess
import sys
import zipfile

import numpy as np
import pytest

from bayesftc import cosim, fmus
from bayesftc.cosim import SSPError

CAR = fmus.path("CruiseControl", fmi="2.0")
H = 0.02
STANDARD = " ".join(
    f'xmlns:{prefix}="http://ssp-standard.org/SSP1/SystemStructure{kind}"'
    for prefix, kind in (
        ("ssd", "Description"),
        ("ssv", "ParameterValues"),
        ("ssm", "ParameterMapping"),
        ("ssc", "Common"),
    )
)
TOOLS = (
    'xmlns:osp="http://opensimulationplatform.com/SSP/OSPAnnotations" '
    'xmlns:oms="https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"'
)
REAL = "<ssc:Real />"


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "cache"))


def connector(name, kind):
    return f'<ssd:Connector name="{name}" kind="{kind}">{REAL}</ssd:Connector>'


def car(name, inside="", before="", connectors=("force", "disturbance"), more=""):
    own = "".join(connector(n, "input") for n in connectors) + connector("v", "output") + more
    return f"""<ssd:Component name="{name}" type="application/x-fmu-sharedlibrary" source="resources/{CAR.name}">{before}
        <ssd:Connectors>{own}</ssd:Connectors>{inside}</ssd:Component>"""


def annotated(type_, text, holder="ssd:Annotations"):
    return f'<{holder}><ssc:Annotation type="{type_}">{text}</ssc:Annotation></{holder}>'


def osp(step, more=""):
    algorithm = f'<osp:Algorithm><osp:FixedStepAlgorithm baseStepSize="{step}"/></osp:Algorithm>'
    return f"<ssd:DefaultExperiment {more}>{annotated('com.opensimulationplatform', algorithm)}</ssd:DefaultExperiment>"


def hint(step):
    return annotated("com.opensimulationplatform", f'<osp:StepSizeHint value="{step}"/>')


def oms(information):
    return annotated(
        "org.openmodelica",
        f"<oms:Annotations><oms:SimulationInformation>{information}</oms:SimulationInformation></oms:Annotations>",
    )


MASTER = '<oms:FixedStepMaster description="oms-ma" stepSize="{}" relativeTolerance="0.000100" />'
# What OMSimulator adds to every experiment, and which is no step.
RESULTS = """<ssd:DefaultExperiment startTime="0.000000" stopTime="1.000000"><ssd:Annotations>
    <ssc:Annotation type="org.openmodelica"><oms:Annotations><oms:SimulationInformation resultFile="x_res.mat"
    loggingInterval="0.000000" bufferSize="10" signalFilter=".*" /></oms:Annotations></ssc:Annotation></ssd:Annotations>
    </ssd:DefaultExperiment>"""
WIRE = '<ssd:Connection startElement="a" startConnector="v" endElement="b" endConnector="disturbance" />'


def structure(elements, connections=WIRE, *, before="", after="", experiment=""):
    """Return an .ssd; `before` stands before the elements of its system, `after` after its connections."""
    wires = f"<ssd:Connections>{connections}</ssd:Connections>" if connections else ""
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription {STANDARD} {TOOLS} name="cars" version="1.0"><ssd:System name="root">{before}
<ssd:Elements>{elements}</ssd:Elements>{wires}{after}</ssd:System>{experiment}</ssd:SystemStructureDescription>"""


def packed(folder, text, **files):
    path = folder / "cars.ssp"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", text)
        archive.write(CAR, f"resources/{CAR.name}")
        for name, content in files.items():
            archive.writestr(f"resources/{name.replace('__', '.')}", content)
    return path


def values(**numbers):
    rows = "".join(f'<ssv:Parameter name="{n}"><ssv:Real value="{v}" /></ssv:Parameter>' for n, v in numbers.items())
    rows = f"<ssv:Parameters>{rows}</ssv:Parameters>"
    return f'<ssv:ParameterSet {STANDARD} version="1.0" name="parameters">{rows}</ssv:ParameterSet>'


def mapping(**targets):
    rows = "".join(
        f'<ssm:MappingEntry source="{source}" target="{target}" />'
        for source, all_ in targets.items()
        for target in all_
    )
    return f'<ssm:ParameterMapping {STANDARD} version="1.0">{rows}</ssm:ParameterMapping>'


def bound(*sources):
    """Return bindings to parameter files, each with a mapping where one is given."""
    inside = ""
    for source in sources:
        set_, map_ = source if isinstance(source, tuple) else (source, None)
        mapped = f'<ssd:ParameterMapping source="resources/{map_}" />' if map_ else ""
        inside += f'<ssd:ParameterBinding source="resources/{set_}">{mapped}</ssd:ParameterBinding>'
    return f"<ssd:ParameterBindings>{inside}</ssd:ParameterBindings>"


def refused(path, *parts, **options):
    with pytest.raises(SSPError) as caught:
        cosim.open_ssp(path, **options)
    for part in parts:
        assert part in str(caught.value), str(caught.value)
    return str(caught.value)


CARS = car("a") + car("b")
STEPS = {
    "OSP": (structure(CARS, experiment=osp("2e-2", 'startTime="0"')), "1/50"),
    "OMSimulator": (structure(CARS, after=oms(MASTER.format("0.020000")), experiment=RESULTS), "1/50"),
    "OMSimulator 2 as it was": (
        structure(
            CARS, after=annotated("org.openmodelica", MASTER.format("0.5").replace("oms:", "")), experiment=RESULTS
        ),
        "1/2",
    ),
    "OMSimulator 3": (
        structure(
            CARS,
            after=annotated(
                "org.openmodelica",
                '<oms:Annotations><oms:SimulationInformation name="solver1" method="oms-ma" fixedStepSize="0.25"/>'
                "</oms:Annotations>",
            ),
        ),
        "1/4",
    ),
    "both, alike": (structure(CARS, after=oms(MASTER.format("0.1")), experiment=osp("1e-1")), "1/10"),
    "ours": (structure(CARS, after=annotated("bayesftc", '<bayesftc step="1/30"/>')), "1/30"),
}


@pytest.mark.parametrize("tool", STEPS)
def test_the_step_in_annotations(tmp_path, tool):
    text, step = STEPS[tool]
    path = packed(tmp_path, text)
    assert str(cosim.open_ssp(path).step) == step
    assert str(cosim.open_ssp(path, dt="1/7").step) == "1/7"


NO_STEP = {
    "nothing": (structure(CARS), "(its FMUs recommend 0.02 s); give dt=... in seconds, as in open_ssp(path, dt=0.02)."),
    "results alone": (structure(CARS, experiment=RESULTS), "gives no step size"),
    "variable steps": (
        structure(
            CARS,
            after=oms('<oms:VariableStepMaster description="oms-mav" minimumStepSize="1e-4" maximumStepSize="0.1" />'),
        ),
        "its solver has variable steps of up to 0.1 s",
    ),
    "hints alone": (structure(car("a", hint("0.05")) + car("b")), "its components have steps of 0.05 s"),
    "a step of a part": (  # that of a system inside is not the whole one's
        structure(
            f"<ssd:System name='inner'><ssd:Elements>{CARS}</ssd:Elements>{oms(MASTER.format('0.1'))}</ssd:System>", ""
        ),
        "gives no step size",
    ),
    "two": (
        structure(CARS, after=oms(MASTER.format("0.1")), experiment=osp("0.2")),
        "gives several steps: baseStepSize=0.2 (FixedStepAlgorithm), stepSize=0.1 (FixedStepMaster)",
    ),
    **{
        f"step {text}": (
            structure(CARS, experiment=osp(text)),
            f"baseStepSize='{text}', which is no step size in seconds",
        )
        for text in ("0", "-0.1", "NaN", "INF", "soon", "1e999999999", "1e-999999999", "1/0")
    },
    "ours, beyond all bounds": (
        structure(CARS, after=annotated("bayesftc", '<bayesftc step="1e999999999"/>')),
        "has step='1e999999999', which is no step size in seconds",
    ),
    "a wrong hint": (
        structure(car("a", hint("-1")) + car("b"), experiment=osp("0.1")),
        "'a' of SystemStructure.ssd has a StepSizeHint of '-1', which is no step size",
    ),
}


@pytest.mark.parametrize("case", NO_STEP)
def test_without_a_step_it_asks_for_one(tmp_path, case):
    text, words = NO_STEP[case]
    assert "dt=..." in refused(packed(tmp_path, text), words)


@pytest.mark.slow
def test_inspect_of_an_ssp_without_a_step(tmp_path):
    command = [sys.executable, "-m", "bayesftc", "inspect", str(packed(tmp_path, structure(CARS)))]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "none is given: open_ssp(path, dt=...)" in text


def test_components_at_steps_of_their_own(tmp_path):
    """As libcosim reads a StepSizeHint: the whole base steps in it, at least one."""
    parts = car("a", hint("0.04")) + car("b", hint("0.05")) + car("c", hint("0.001")) + car("d")
    diagram = cosim.open_ssp(packed(tmp_path, structure(parts, experiment=osp("0.02"))))
    assert {node.name: node.every for node in diagram.nodes} == {"a": 2, "b": 2, "c": 1, "d": 1}


def test_connectors_of_the_whole_system(tmp_path):
    """An absent element, and an empty one, mean the system itself."""
    own = "".join(
        connector(*c) for c in (("push", "input"), ("heavy", "parameter"), ("speed", "output"), ("loose", "input"))
    )
    wires = """
        <ssd:Connection startElement="" startConnector="push" endElement="a" endConnector="force" />
        <ssd:Connection startConnector="push" endElement="b" endConnector="force" />
        <ssd:Connection startElement="" startConnector="heavy" endElement="b" endConnector="m" />
        <ssd:Connection startElement="b" startConnector="v" endElement="" endConnector="speed" />"""
    heavy = car("b", more=connector("m", "parameter"))
    before = f"<ssd:Connectors>{own}</ssd:Connectors>{bound('root.ssv')}"
    text = structure(car("a") + heavy, WIRE + wires, before=before, after=oms(MASTER.format("0.020000")))
    root = values(push=40.0, heavy=250.0, loose=3.0)
    path = packed(tmp_path, text, root__ssv=root)
    diagram = cosim.open_ssp(path)  # without a word of `loose`, which is there, and feeds nothing
    assert diagram["a"].block.parameters == {"force": 40.0}
    assert diagram["b"].block.parameters == {"force": 40.0, "m": 250.0}
    result = diagram.build("jacobi").simulate(1.0, engine="interpreted")
    np.testing.assert_allclose(result["a.v"][:3], [0.0, 0.008, 0.008 * 0.999 + 0.008], rtol=1e-12)
    assert result["b.v"][2] == pytest.approx((0.02 / 250 * 40) * (1 - 5 / 250 * 0.02) + 0.0032 + 0.008, rel=1e-9)
    wrong = text.replace('startConnector="heavy"', 'startConnector="heave"')
    refused(packed(tmp_path, wrong, root__ssv=root), "from heave to b.m in SystemStructure.ssd", "did you mean 'heavy'")


def test_parameter_files_of_systems_and_components_with_mappings(tmp_path):
    """One source for several targets, parts of the system among them; what a mapping does not name keeps its name."""
    own = connector("push", "input") + connector("all_m", "parameter")
    wires = '<ssd:Connection startElement="" startConnector="push" endElement="a" endConnector="force" />'
    text = structure(
        car("a", bound("a.ssv", ("second.ssv", "second.ssm"))) + car("b"),
        WIRE + wires,
        before=f"<ssd:Connectors>{own}</ssd:Connectors>{bound(('root.ssv', 'root.ssm'))}",
        after=oms(MASTER.format("0.020000")),
    )
    files = {
        "root__ssv": values(shared_mass=120.0, push=9.0),
        "root__ssm": mapping(shared_mass=["a.m", "b.m", "all_m"]),
        "a__ssv": values(v0=3.0, b=4.0),
        "second__ssv": values(drag=6.0),
        "second__ssm": mapping(drag=["b"]),
    }
    diagram = cosim.open_ssp(packed(tmp_path, text, **files))
    assert diagram["a"].block.parameters == {"v0": 3.0, "b": 6.0, "force": 9.0, "m": 120.0}
    assert diagram["b"].block.parameters == {"m": 120.0}


def test_units_in_brackets(tmp_path):
    tonnes = values(m=0.2).replace("<ssv:Real", '<ssv:Real unit="[t]"')
    text = structure(car("a", bound("a.ssv")), "", experiment=osp(H))
    assert cosim.open_ssp(packed(tmp_path, text, a__ssv=tonnes))["a"].block.parameters == {"m": pytest.approx(200.0)}
    refused(packed(tmp_path, text, a__ssv=tonnes.replace("[t]", "[smoots]")), "the unit '[smoots]' is not known")


def test_parts_in_another_order_and_empty_lists(tmp_path):
    """OMSimulator has written such; their meaning is clear, so a warning names them."""
    text = structure(
        f"<ssd:System name='inner'><ssd:Elements>{car('a', before=hint(H))}</ssd:Elements><ssd:Connections /></ssd:System>",
        "",
        before=oms(MASTER.format("0.020000")),
    )
    path = packed(tmp_path, text)
    with pytest.warns(UserWarning, match="breaks the rules of SSP, but its meaning is clear: line 3.*other tools may"):
        diagram = cosim.open_ssp(path)
    assert [node.name for node in diagram.nodes] == ["inner.a"]
    other = text.replace('kind="input"', 'kind="input" colour="red"')
    refused(packed(tmp_path, other), "breaks the rules of SSP", "colour")


def osp_cars(tmp_path, step=H):
    """Return an SSP in libcosim's dialect: one car pushes the other."""
    start = f"""<ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues>{values(force=100.0)}</ssd:ParameterValues>
        </ssd:ParameterBinding></ssd:ParameterBindings>"""
    linear = WIRE.replace(" />", '><ssc:LinearTransformation offset="0.25" factor="0.5"/></ssd:Connection>')
    return packed(tmp_path, structure(car("a", start) + car("b"), linear, experiment=osp(step)))


def in_libcosim(path, folder, steps):
    """Return the speeds of both cars as libcosim computes them from the .ssp, at the step that it finds in it."""
    execution = pytest.importorskip("libcosimpy.CosimExecution").CosimExecution
    observer = pytest.importorskip("libcosimpy.CosimObserver").CosimObserver.create_last_value()
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    whole = execution.from_ssp_file(str(folder))
    assert whole.add_observer(observer)
    reference = {v.name: v.reference for v in cosim.open_ssp(path)["a"].block.description.variables}["v"]
    rows = []
    for k in range(steps + 1):
        assert not k or whole.step()
        rows.append([observer.last_real_values(whole.slave_index_from_instance_name(n), [reference])[0] for n in "ab"])
    return np.array(rows)


def test_libcosim_runs_the_same_system(tmp_path):
    """It reads the step, the values and the transformation from the same file."""
    path = osp_cars(tmp_path)
    theirs = in_libcosim(path, tmp_path / "unpacked", 50)
    ours = cosim.open_ssp(path).build("jacobi").simulate(1.0, engine="interpreted")
    assert ours["b.v"][-1] > 1.0
    np.testing.assert_allclose(theirs, np.stack([ours["a.v"], ours["b.v"]], axis=1), rtol=1e-9)


def test_libcosim_finds_the_step_of_what_is_saved_here(tmp_path):
    again = cosim.save_ssp(cosim.open_ssp(osp_cars(tmp_path, 0.04)), tmp_path / "again.ssp")
    opened = cosim.open_ssp(again)
    assert str(opened.step) == "1/25"
    ours = opened.build("jacobi").simulate(2.0, engine="interpreted")
    theirs = in_libcosim(again, tmp_path / "unpacked", 50)
    np.testing.assert_allclose(theirs, np.stack([ours["a.v"], ours["b.v"]], axis=1), rtol=1e-9)


def test_an_ssp_made_by_another_package(tmp_path):
    """pyssp_standard writes the structure, the values and the mapping, in its own order and spelling."""
    pytest.importorskip("pyssp_standard", reason="pyssp_standard makes SSPs; it is not installed")
    from lxml import etree
    from pyssp_standard.common_content_ssc import Annotation, TypeReal
    from pyssp_standard.ssd import Component, Connection, Connector, ParameterBinding, ParameterMapping, System
    from pyssp_standard.ssm import SSM
    from pyssp_standard.ssp import SSP
    from pyssp_standard.ssv import SSV

    def connectors(*pairs):
        return [Connector(None, name, kind, TypeReal(None)) for name, kind in pairs]

    with SSV(tmp_path / "start.ssv", "w") as set_:
        set_.add_parameter("mass", "Real", value=0.15, unit="t")
        set_.add_unit("t", {"kg": 1, "factor": 1000})
        set_.add_parameter("push", "Real", value=40.0, unit="N")
        set_.add_unit("N")
    with SSM(tmp_path / "start.ssm", "w") as map_:
        map_.add_mapping("mass", "a.m")
        map_.add_mapping("mass", "b.m")
    system = System(name="root")
    system.connectors = connectors(("push", "input"), ("speed", "output"))
    system.parameter_bindings = [
        ParameterBinding(source="resources/start.ssv", parameter_mapping=ParameterMapping(source="resources/start.ssm"))
    ]
    for name in "ab":
        part = Component()
        part.name, part.source, part.component_type = name, f"resources/{CAR.name}", "application/x-fmu-sharedlibrary"
        part.connectors = connectors(("force", "input"), ("disturbance", "input"), ("v", "output"))
        system.elements.append(part)
    for start, end in (
        ((None, "push"), ("a", "force")),
        (("a", "v"), ("b", "disturbance")),
        (("b", "v"), (None, "speed")),
    ):
        names = dict(
            zip(("start_element", "start_connector", "end_element", "end_connector"), (*start, *end), strict=True)
        )
        system.connections.append(Connection(**names))
    step = Annotation("com.opensimulationplatform")
    algorithm = etree.Element("{http://opensimulationplatform.com/SSP/OSPAnnotations}Algorithm")
    etree.SubElement(algorithm, algorithm.tag.replace("Algorithm", "FixedStepAlgorithm"), baseStepSize="0.02")
    step.add_element(algorithm)
    system.annotations.add_annotation(step)
    with SSP(tmp_path / "made.ssp", mode="w") as archive:
        for file in (CAR, tmp_path / "start.ssv", tmp_path / "start.ssm"):
            archive.add_resource(file)
        with archive.system_structure as made:
            made.name, made.version, made.system = "cars", "1.0", system
    diagram = cosim.open_ssp(tmp_path / "made.ssp")
    assert diagram["a"].block.parameters == {"m": pytest.approx(150.0), "force": 40.0}
    assert diagram["b"].block.parameters == {"m": pytest.approx(150.0)}
    result = diagram.build("jacobi").simulate(0.06, engine="interpreted")
    v = 40 * H / 150
    np.testing.assert_allclose(result["b.v"], [0, 0, v, v * (1 - 5 / 150 * H) + v * (2 - 5 / 150 * H)], rtol=1e-12)
