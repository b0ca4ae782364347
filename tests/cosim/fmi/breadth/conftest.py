"""An FMU of each version of FMI with ports of every type, arrays and events, built of fmi2.c and fmi3.c at its first use."""

import re
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim.fmi.fmu import FMU

HERE = Path(__file__).parent

DESCRIPTION = {
    "3": """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Breadth" instantiationToken="{b}">
  <CoSimulation modelIdentifier="Breadth" canHandleVariableCommunicationStepSize="true" FLAGS/>
  <UnitDefinitions>
    <Unit name="Grad/s"><BaseUnit rad="1" s="-1" factor="0.015707963267948967"/></Unit>
    <Unit name="K"><BaseUnit K="1"/><DisplayUnit name="Rankine" factor="1.8"/></Unit>
  </UnitDefinitions>
  <TypeDefinitions>
    <EnumerationType name="Mode"><Item name="off" value="1"/><Item name="on" value="2"/></EnumerationType>
  </TypeDefinitions>
  <ModelVariables>
    <UInt64 name="n" valueReference="1" causality="structuralParameter" variability="fixed" start="2"/>
    <Float64 name="u" valueReference="2" causality="input" start="0"><Dimension valueReference="1"/></Float64>
    <Float64 name="K" valueReference="3" causality="parameter" variability="fixed" start="1 0 0 1" unit="Grad/s">
      <Dimension valueReference="1"/><Dimension valueReference="1"/></Float64>
    <Float64 name="x0" valueReference="4" causality="parameter" variability="fixed" start="0" unit="K">
      <Dimension valueReference="1"/></Float64>
    <Float64 name="y" valueReference="5" causality="output"><Dimension valueReference="1"/></Float64>
    <Float64 name="k" valueReference="6" causality="parameter" variability="tunable" start="1"/>
    <Float64 name="total" valueReference="7" causality="output"/>
    <Float64 name="stall" valueReference="8" causality="parameter" variability="fixed" start="0"/>
    <Int32 name="count" valueReference="9" causality="output"/>
    <Int32 name="next" valueReference="10" causality="input" start="1"/>
    <Int8 name="byte" valueReference="11" causality="input" start="0"/>
    <Int8 name="byte_out" valueReference="12" causality="output"/>
    <Int64 name="wide" valueReference="13" causality="input" start="0"/>
    <Int64 name="twice" valueReference="14" causality="output"/>
    <Boolean name="flag" valueReference="15" causality="input" start="false"/>
    <Boolean name="flag_out" valueReference="16" causality="output"/>
    <Enumeration declaredType="Mode" name="mode" valueReference="17" causality="input" start="1"/>
    <Enumeration declaredType="Mode" name="mode_out" valueReference="18" causality="output"/>
    <Float32 name="single" valueReference="19" causality="input" start="0"/>
    <Float32 name="single_out" valueReference="20" causality="output"/>
    <UInt16 name="word" valueReference="21" causality="input" start="0"/>
    <UInt16 name="word_out" valueReference="22" causality="output"/>
    <String name="label" valueReference="23" causality="parameter" variability="fixed"><Start value="none"/></String>
    <Int32 name="length" valueReference="24" causality="output"/>
    <Float64 name="numbers" valueReference="25" causality="input" start="1.5 2.5"><Dimension start="2"/></Float64>
    <Float64 name="time" valueReference="99" causality="independent" variability="continuous"/>
  </ModelVariables>
  <ModelStructure>OUTPUTS</ModelStructure>
</fmiModelDescription>""".replace(
        "OUTPUTS",
        "".join(f'<Output valueReference="{r}" dependencies=""/>' for r in (5, 7, 9, 12, 14, 16, 18, 20, 22, 24)),
    ),
    "2": """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Breadth" guid="{b}">
  <CoSimulation modelIdentifier="Breadth" FLAGS/>
  <TypeDefinitions><SimpleType name="Mode"><Enumeration><Item name="off" value="1"/><Item name="on" value="2"/>
  </Enumeration></SimpleType></TypeDefinitions>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="0" causality="input"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="k" valueReference="1" causality="parameter" variability="tunable"><Real start="1"/></ScalarVariable>
    <ScalarVariable name="x" valueReference="2" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="most" valueReference="3" causality="parameter" variability="fixed"><Real start="1e9"/></ScalarVariable>
    <ScalarVariable name="reach" valueReference="4" causality="parameter" variability="fixed"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="steps" valueReference="5" causality="output" variability="discrete"><Integer/></ScalarVariable>
    <ScalarVariable name="count" valueReference="6" causality="input" variability="discrete"><Integer start="0"/></ScalarVariable>
    <ScalarVariable name="count_out" valueReference="7" causality="output" variability="discrete"><Integer/></ScalarVariable>
    <ScalarVariable name="flag" valueReference="8" causality="input" variability="discrete"><Boolean start="0"/></ScalarVariable>
    <ScalarVariable name="flag_out" valueReference="9" causality="output" variability="discrete"><Boolean/></ScalarVariable>
    <ScalarVariable name="mode" valueReference="10" causality="input" variability="discrete">
      <Enumeration declaredType="Mode" start="1"/></ScalarVariable>
    <ScalarVariable name="mode_out" valueReference="11" causality="output" variability="discrete">
      <Enumeration declaredType="Mode"/></ScalarVariable>
    <ScalarVariable name="lie" valueReference="12" causality="parameter" variability="fixed"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="end" valueReference="13" causality="parameter" variability="fixed"><Real start="1e9"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure><Outputs>OUTPUTS</Outputs><InitialUnknowns>OUTPUTS</InitialUnknowns></ModelStructure>
</fmiModelDescription>""".replace(
        "OUTPUTS", "".join(f'<Unknown index="{i}" dependencies=""/>' for i in (3, 6, 8, 10, 12))
    ),
}


@pytest.fixture(scope="session")
def breadth(tmp_path_factory, c_compiler):
    """Return a function that returns the FMU of a version of FMI with some flags of its description."""
    compiler = c_compiler
    import fmpy

    folder = tmp_path_factory.mktemp("breadth")
    headers = Path(fmpy.__file__).parent / "c-code"
    binaries = {}
    for major in "23":
        text = (HERE / f"fmi{major}.c").read_text()
        wanted = set(re.findall(rf"\b(fmi{major}\w+?)TYPE\b", (headers / f"fmi{major}Functions.h").read_text()))
        macros = {"2": {"fmi2SetReal", "fmi2GetReal"}}.get(major) or {
            f"fmi3{verb}{kind}" for verb in ("Get", "Set") for kind in ("Int8", "UInt16", "Boolean", "Float32")
        }
        stubs = " ".join(f"STUB({n})" for n in sorted(wanted) if n not in macros and not re.search(rf"\b{n}\(", text))
        source, library = folder / f"fmi{major}.c", folder / f"fmi{major}.so"
        source.write_text(text.replace("\nSTUBS\n", f"\n{stubs}\n"))
        subprocess.run([compiler, "-O1", "-w", "-shared", "-fPIC", str(source), "-o", str(library), "-lm"], check=True)
        binaries[major] = library.read_bytes()

    def make(major, flags=""):
        name = f"{major}{''.join(c for c in flags if c.isalnum())}.fmu"
        if not (folder / name).exists():
            place = fmpy.platform if major == "2" else fmpy.platform_tuple
            with zipfile.ZipFile(folder / name, "w") as archive:
                archive.writestr("modelDescription.xml", DESCRIPTION[major].replace("FLAGS", flags))
                archive.writestr(f"binaries/{place}/Breadth{fmpy.sharedLibraryExtension}", binaries[major])
        return folder / name

    return make


@pytest.fixture(scope="session")
def alone():
    """Return a function that returns a diagram of a block and sources for its inputs."""

    def alone(block, dt, *sources):
        diagram = cosim.Diagram(dt=dt)
        node = diagram.add(block, "b")
        for name, source in sources:
            diagram.connect(diagram.add(source, f"s_{name}")["y"], node[name])
        return diagram

    return alone


@pytest.fixture(scope="session")
def mixer(breadth):
    """Return a function that returns an FMU of three states, each of which is moved by more than one input."""
    mix = np.array([[1.0, 0.5, 0.0], [0.0, 1.0, -0.5], [0.5, 0.0, 2.0]])

    def mixer(**start):
        return FMU(breadth("3"), parameters={"n": 3, "K": mix, "x0": [0.0, 0.0, 0.0], **start})

    return mixer
