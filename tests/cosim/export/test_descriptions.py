"""What the descriptions of exported FMUs say, by validators, and by what the FMUs do.

What goes into a description does not depend on a compiler, so all kinds of block are looked at.
"""

import zipfile
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from bayesftc import cosim
from bayesftc.cosim.export.c_file import write_c
from bayesftc.cosim.export.fmu import model_of
from bayesftc.cosim.export.program import program_of
from bayesftc.fmus.build import FMI_VERSIONS, build_fmu


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
