"""What the descriptions of exported FMUs say, by validators, and by what the FMUs do.

What goes into a description does not depend on a compiler, so all kinds of block are looked at.
"""

import zipfile
from xml.etree import ElementTree as ET

import control
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from bayesftc import controllers, cosim
from bayesftc.cosim.export.c_file import write_c
from bayesftc.cosim.export.fmu import model_of
from bayesftc.cosim.export.program import program_of
from bayesftc.fmus.build import FMI_VERSIONS, build_fmu


def test_the_header_in_c_says_what_the_description_of_the_fmu_says():
    """Nothing in the header said that a goal lies ahead, nor which sensor is y[2]."""
    axis = control.ss([[0.0, 1.0], [0.0, -1.0]], [[0.0], [1.0]], np.eye(2), 0, inputs=["force"], outputs=["x", "v"])
    controller = controllers.design(
        axis, measured=["x", "v"], sensors=[2, 1], actuated="force", goal="x", dt=0.05, sensor_std=0.1,
        acceptable_error=0.1, acceptable_control=1.0, preview=20, precision=controllers.GammaPrecision(),
    )  # fmt: skip
    program = program_of(controller, name="axis")
    file = write_c(program)
    header = " ".join(file.header.replace("/*", "").replace("*/", "").split())
    for variable in model_of(program, file, None, "").variables:
        assert variable.description in header, variable.name
    assert "    /* Samples of the sensors (x, x, v); NaN is a missing one */\n    double y[3];\n" in file.header
    assert "    /* Goal of 20 samples later; NaN keeps the last */\n    double goal[1];\n" in file.header
    assert max(map(len, file.header.splitlines())) <= 130


def test_each_element_of_the_belief_has_its_state_in_fmi_2():
    axis = control.ss(
        [[0.0, 1.0], [0.0, -1.0]], [[0.0], [1.0]], np.eye(2), 0, inputs=["force"], outputs=["x", "v"], states=["x", "v"]
    )
    controller = controllers.design(
        axis, measured=["x", "v"], sensors=[2, 1], actuated="force", goal="x", dt=0.05, sensor_std=0.1,
        acceptable_error=0.1, acceptable_control=1.0, disturbance=0.1, precision=controllers.GammaPrecision(),
    )  # fmt: skip
    program = program_of(controller, name="axis")
    model = model_of(program, write_c(program), None, "")
    told = {variable.name: variable.description for variable in model.flat().variables}
    states = ["x", "v", "disturbance[0]"]
    assert [told[f"x_hat[{i}]"] for i in range(3)] == [
        f"Mean of the belief about the state ({name})" for name in states
    ]
    assert [told[f"y[{i}]"] for i in range(3)] == [f"Samples of the sensors ({x}); NaN is a missing one" for x in "xxv"]
    assert next(v for v in model.variables if v.name == "x_hat").description.count("state") == 1


def test_each_sample_has_its_unit_in_fmi_2():
    axis = control.ss([[0.0, 1.0], [0.0, -1.0]], [[0.0], [1.0]], np.eye(2), 0, inputs=["force"], outputs=["x", "v"])
    controller = controllers.design(
        axis, measured=["x", "v"], sensors=[2, 1], actuated="force", goal="x", dt=0.05, sensor_std=0.1,
        precision=controllers.GammaPrecision(),
    )  # fmt: skip
    loop = cosim.closed_loop(
        axis, controller, control="force", measured=["x", "v"], reference=1.0,
        sensors=cosim.Sensors([2, 1], 0.1, unit=["mm", "mm/s"]),
    )  # fmt: skip
    program = program_of(loop, blocks="controller")
    file = write_c(program)
    model = model_of(program, file, None, "")
    units = {v.name: None if v.unit is None else v.unit.name for v in model.flat().variables}
    assert [units[name] for name in ("y[0]", "y[1]", "y[2]", "goal[0]")] == ["mm", "mm", "mm/s", "mm"]
    assert next(v for v in model.variables if v.name == "y").unit is None  # an array of FMI 3 has one unit or none
    assert "double y[3]; /* mm, mm, mm/s */" in file.header
    assert {"mm", "mm/s"} <= {unit.name for unit in model.flat().units}


def test_the_text_of_a_port_does_not_end_a_comment_of_the_header(make_block):
    def act(u, y):
        y[0] = u[0]

    text = "A gain */ int x; /* of " + "many words " * 20
    block = make_block(output=act, inputs=[cosim.Port("u", description=text)], outputs=[cosim.Port("y")])
    header = write_c(program_of(block, name="gain", dt=0.1)).header
    assert "A gain * / int x; / * of many words" in header
    assert header.count("/*") == header.count("*/")


@pytest.mark.sampled(2)
def test_validators_find_nothing(block, sample_time, tmp_path):
    """fmpy's, against the schemas of the standard and by its rules: references, InitialUnknowns, units, start values."""
    program = program_of(block, name="it", dt=sample_time(block))
    model = model_of(program, write_c(program), None, "")
    for fmi in FMI_VERSIONS:
        path = build_fmu(model, tmp_path, fmi=fmi, platforms=())
        assert validate_fmu(str(path)) == []
        with zipfile.ZipFile(path) as archive:
            root = ET.fromstring(archive.read("modelDescription.xml"))
        annotations = root.find("VendorAnnotations/Tool" if fmi == "2.0" else "Annotations/Annotation")
        assert annotations.get("name" if fmi == "2.0" else "type") == "bayesftc"
        assert annotations.find("bayesftc").get("timing") in {"plant", "sampled"}
        # No output acts at once on an input of the same instant: a step is made between, and importers must not see loops.
        outputs = root.findall("ModelStructure/" + ("Outputs/Unknown" if fmi == "2.0" else "Output"))
        assert outputs
        assert all(output.get("dependencies") == "" for output in outputs)


@pytest.mark.slow
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_initial_outputs_depend_on_what_is_declared(instance, tmp_path, blocks, c_compiler, fmi):
    """Each input is moved in initialization mode; what moves with it must be declared, and here all of it does."""
    it = instance(cosim.export_fmu(blocks["GammaPrecision"], tmp_path / "it.fmu", fmi=fmi))
    it.enter()
    names = {v.valueReference: v.name.partition("[")[0] for v in it.description.modelVariables}
    declared = {}
    for unknown in it.description.initialUnknowns:
        known = {names[variable.valueReference] for variable in unknown.dependencies}
        declared.setdefault(names[unknown.variable.valueReference], set()).update(known)
    inputs = [name for name in ("y", "goal") if name in declared["u"]]
    assert inputs == ["y", "goal"]
    before = {name: it.get(name) for name in declared}
    for name in inputs:
        it.set(**{name: np.full(it.size[name], 3.0)})
        moved = {
            output for output, value in before.items() if not np.array_equal(it.get(output), value, equal_nan=True)
        }
        assert "u" in moved
        assert all(name in declared[output] for output in moved)
        it.set(**{name: np.zeros(it.size[name])})
