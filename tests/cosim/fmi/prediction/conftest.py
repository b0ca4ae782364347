"""An FMU of FMI 2 for model exchange with directional derivatives, built of curved.c, and one without them."""

import inspect
import re
import subprocess
import zipfile
from pathlib import Path

import pytest

HERE = Path(__file__).parent
DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="curved" guid="curved" numberOfEventIndicators="{indicators}">
<ModelExchange modelIdentifier="curved" completedIntegratorStepNotNeeded="true" {flags}/>
<ModelVariables>
<ScalarVariable name="x" valueReference="0" causality="local" variability="continuous" initial="exact">
<Real start="0.5"/></ScalarVariable>
<ScalarVariable name="v" valueReference="1" causality="local" variability="continuous" initial="exact">
<Real start="0"/></ScalarVariable>
<ScalarVariable name="der(x)" valueReference="2" causality="local" variability="continuous">
<Real derivative="1"/></ScalarVariable>
<ScalarVariable name="der(v)" valueReference="3" causality="local" variability="continuous">
<Real derivative="2"/></ScalarVariable>
<ScalarVariable name="u" valueReference="4" causality="input" variability="continuous">
<Real start="0"/></ScalarVariable>
<ScalarVariable name="y" valueReference="5" causality="output" variability="continuous">
<Real/></ScalarVariable>
{more}
</ModelVariables>
<ModelStructure><Outputs><Unknown index="6"/></Outputs><Derivatives><Unknown index="3"/><Unknown index="4"/></Derivatives>
<InitialUnknowns><Unknown index="3"/><Unknown index="4"/><Unknown index="6"/></InitialUnknowns></ModelStructure>
</fmiModelDescription>"""
DISCRETE = (
    '<ScalarVariable name="gear" valueReference="6" causality="local" variability="discrete" initial="exact">'
    '<Real start="1"/></ScalarVariable>'
)
KINDS = {
    "plain": {},
    "directional": {"flags": 'providesDirectionalDerivative="true"'},
    "events": {"indicators": 1},
    "discrete": {"more": DISCRETE},
    "once": {"flags": 'canBeInstantiatedOnlyOncePerProcess="true"'},
}


@pytest.fixture(scope="session")
def curved(tmp_path_factory, c_compiler):
    """Return the path of the FMU, of one of the kinds."""
    import fmpy
    from fmpy.fmi2 import FMU2Model

    folder, made = tmp_path_factory.mktemp("curved"), {}
    text = (HERE / "curved.c").read_text()
    names = [name for name, _ in inspect.getmembers(FMU2Model) if name.startswith("fmi2")]
    absent = [name for name in names if not re.search(rf"\b{name}\b", text)]
    (folder / "absent.c").write_text("".join(f"int {name}(void) {{ return 3; }}\n" for name in absent))
    library = folder / f"curved{fmpy.sharedLibraryExtension}"
    headers = Path(fmpy.__file__).parent / "c-code"
    flags = ["-shared", "-fPIC", "-O1", "-w", "-ffp-contract=off", f"-I{headers}"]
    subprocess.run(
        [c_compiler, *flags, str(HERE / "curved.c"), str(folder / "absent.c"), "-o", str(library), "-lm"], check=True
    )

    def path(kind):
        if kind not in made:
            made[kind] = folder / f"{kind}.fmu"
            given = {"flags": "", "indicators": 0, "more": ""} | KINDS[kind]
            with zipfile.ZipFile(made[kind], "w") as archive:
                archive.writestr("modelDescription.xml", DESCRIPTION.format(**given))
                archive.write(library, f"binaries/{fmpy.platform}/{library.name}")
        return made[kind]

    return path
