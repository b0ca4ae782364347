"""FMUs that are hostile in what they do, in their archive, their description and their binary."""

from __future__ import annotations

import io
import re
import stat
import struct
import subprocess
import zipfile
from pathlib import Path

import numpy as np
from mutations import damaged

DESCRIPTION = "modelDescription.xml"
LIBRARY = "binaries/linux64/hostile.so", "binaries/x86_64-linux/hostile.so"

TWO = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="hostile" guid="g" numberOfEventIndicators="1">
<ModelExchange modelIdentifier="hostile"/>
<CoSimulation modelIdentifier="hostile" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables>
<ScalarVariable name="u" valueReference="0" causality="input" variability="continuous"><Real start="0"/></ScalarVariable>
<ScalarVariable name="x" valueReference="1" causality="local" variability="continuous" initial="exact">
<Real start="0"/></ScalarVariable>
<ScalarVariable name="der(x)" valueReference="2" causality="local" variability="continuous">
<Real derivative="2"/></ScalarVariable>
<ScalarVariable name="y" valueReference="3" causality="output" variability="continuous"><Real/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="4" dependencies="2"/></Outputs><Derivatives><Unknown index="3"/></Derivatives>
<InitialUnknowns><Unknown index="3"/><Unknown index="4"/></InitialUnknowns></ModelStructure></fmiModelDescription>
"""
THREE = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="hostile" instantiationToken="g">
<ModelExchange modelIdentifier="hostile"/>
<CoSimulation modelIdentifier="hostile" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables>
<Float64 name="time" valueReference="9" causality="independent" variability="continuous"/>
<Float64 name="u" valueReference="0" causality="input" variability="continuous" start="0"/>
<Float64 name="x" valueReference="1" causality="local" variability="continuous" initial="exact" start="0"/>
<Float64 name="der(x)" valueReference="2" causality="local" variability="continuous" derivative="1"/>
<Float64 name="y" valueReference="3" causality="output" variability="continuous"/>
<Float64 name="z" valueReference="4" causality="local" variability="continuous"/>
</ModelVariables>
<ModelStructure><Output valueReference="3" dependencies="1"/><ContinuousStateDerivative valueReference="2"/>
<InitialUnknown valueReference="2"/><InitialUnknown valueReference="3"/><EventIndicator valueReference="4"/></ModelStructure>
</fmiModelDescription>
"""
TEXTS = {"2.0": TWO, "3.0": THREE}
BEHAVIOUR = {
    "co-simulation": (
        "Instantiate",
        "EnterInitializationMode",
        "ExitInitializationMode",
        "Get",
        "Set",
        "DoStep",
        "Terminate",
        "FreeInstance",
    ),
    "model exchange": (
        *(
            "Instantiate",
            "ExitInitializationMode",
            "Get",
            "Set",
            "GetDerivatives",
            "GetEventIndicators",
            "NewDiscreteStates",
        ),
        *(
            "GetContinuousStates",
            "SetContinuousStates",
            "SetTime",
            "CompletedIntegratorStep",
            "EnterEventMode",
            "GetNominals",
        ),
        *("EnterContinuousTimeMode", "GetNumbers", "FreeInstance"),
    ),
}
KIND_WAYS = ("1", "2", "3", "4", "77", "-7", "nan", "inf", "1e300", "none", "print", "thread", "huge", "many")
"""Ways that an FMU may have in this process as well as in one of its own."""
WAYS = (*KIND_WAYS, "crash", "exit", "abort", "kill", "hang", "fork", "close", "mask")


def build(folder: Path, compiler: str) -> dict[str, bytes]:
    """Return the binary of hostile.c for each version of FMI."""
    import fmpy

    source, found = Path(__file__).with_name("hostile.c"), {}
    for fmi in TEXTS:
        prefix = f"fmi{fmi[0]}"
        text = source.read_text()
        known = {f"{prefix}{name}" for name in re.findall(rf"(?:FMI\(|{prefix})(\w+)\)?\(", text)}
        names = set(re.findall(rf"\b{prefix}[A-Z]\w+", (Path(fmpy.__file__).parent / f"fmi{fmi[0]}.py").read_text()))
        absent = folder / f"absent{fmi[0]}.c"
        absent.write_text("".join(f"int {name}(void) {{ return 3; }}\n" for name in sorted(names - known)))
        library = folder / f"hostile{fmi[0]}.so"
        flags = ["-shared", "-fPIC", "-O1", "-w", f"-DFMI{fmi[0]}", "-pthread"]
        subprocess.run([compiler, *flags, str(source), str(absent), "-o", str(library), "-lm"], check=True)
        found[fmi] = library.read_bytes()
    return found


def fmu(fmi: str, library: bytes | None, text: str | bytes | None = None, entries=(), **options) -> bytes:
    """Return an FMU with a binary, a description and further entries."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED, **options) as archive:
        archive.writestr(DESCRIPTION, TEXTS[fmi] if text is None else text)
        if library is not None:
            archive.writestr(LIBRARY[fmi == "3.0"], library)
        for entry, data in entries:
            archive.writestr(entry, data)
    return content.getvalue()


def hostile_archive(fmi: str, library: bytes, rng: np.random.Generator) -> bytes:
    """Return an FMU whose zip file is not what it should be."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of names that stand twice
        way = int(rng.integers(8))
        if way == 0:
            names = (
                "../evil",
                "/tmp/evil",
                "a/../../evil",
                "C:\\evil",
                "resources/..",
                "a\0b",
                "x" * 300,
                "con",
                "resources//a",
                "~",
            )
            return fmu(fmi, library, entries=[(str(rng.choice(names)), b"evil")])
        if way == 1:
            entry = zipfile.ZipInfo("resources/link")
            entry.external_attr = (int(rng.choice([stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR])) | 0o777) << 16
            return fmu(fmi, library, entries=[(entry, b"/etc/passwd")])
        if way == 2:
            return fmu(
                fmi, library, entries=[(str(rng.choice([DESCRIPTION, *LIBRARY, "MODELDESCRIPTION.XML"])), b"other")]
            )
        if way == 3:
            return fmu(
                fmi, library, entries=[(f"resources/{i}", bytes(60_000_000)) for i in range(int(rng.integers(1, 4)))]
            )
        whole = bytearray(fmu(fmi, library, entries=[("resources/inner.fmu", fmu(fmi, library))]))
        if way == 4:
            return bytes(whole[: int(rng.integers(len(whole)))])
        if way == 5:  # sizes, checksums, places and flags that are not so
            marks = [m.start() for m in re.finditer(rb"PK\x01\x02|PK\x03\x04|PK\x05\x06", whole)]
            at = int(rng.choice(marks)) + int(rng.integers(4, 46))
            whole[at : at + 4] = struct.pack(
                "<I", int(rng.choice([0, 1, 8, 2**31, 2**32 - 1, int(rng.integers(2**32))]))
            )
            return bytes(whole)
        if way == 6:
            return bytes(whole) + rng.bytes(50) if rng.random() < 0.5 else rng.bytes(50) + bytes(whole)
        return damaged(bytes(whole), rng)


ODD = (
    *(
        "",
        " ",
        "0",
        "-1",
        "1",
        "2",
        "3",
        "99999999999",
        "1e999",
        "NaN",
        "INF",
        "-INF",
        "true",
        "nothing",
        "é💥",
        "../../x",
        "&amp;",
    ),
    *(
        "x" * 10_000,
        "1 2 3",
        "input",
        "output",
        "parameter",
        "continuous",
        "fixed",
        "exact",
        "calculated",
        "u",
        "y",
        "der(x)",
        "2.0",
        "4.0",
    ),
)
DOCTYPE = '<!DOCTYPE f [<!ENTITY a "b"><!ENTITY c "&a;&a;&a;&a;&a;">]>'


def hostile_description(text: str, rng: np.random.Generator) -> bytes:
    """Return a model description with one to three mutations."""
    for _ in range(rng.geometric(0.6)):
        way = int(rng.integers(9))
        elements = list(
            re.finditer(r"<(\w+)[^<>]*/>|<(\w+)[^<>]*>[^<>]*</\2>|<(\w+)[^<>]*>(?:(?!<\3\b).)*?</\3>", text, re.S)
        )
        attributes = list(re.finditer(r'(\w+)="([^"]*)"', text))
        if not elements or not attributes:
            break
        element, attribute = elements[int(rng.integers(len(elements)))], attributes[int(rng.integers(len(attributes)))]
        other = elements[int(rng.integers(len(elements)))]
        if way < 3:
            text = text[: attribute.start(2)] + str(rng.choice(ODD)) + text[attribute.end(2) :]
        elif way == 3:
            text = text[: attribute.start()] + text[attribute.end() :]
        elif way == 4:
            text = (
                text[: attribute.start(1)]
                + str(rng.choice(["x", "name", "start", "min", "unit", "derivative"]))
                + text[attribute.end(1) :]
            )
        elif way == 5:
            text = text[: element.start()] + text[element.end() :]
        elif way == 6:
            text = text[: element.start()] + element[0] * int(rng.integers(2, 5)) + text[element.end() :]
        elif way == 7:
            text = text[: element.start()] + other[0] + text[element.end() :]
        else:
            names = (
                "Real",
                "Integer",
                "Float64",
                "Int32",
                "String",
                "Binary",
                "Clock",
                "Dimension",
                "Unknown",
                "Outputs",
                "x",
            )
            text = text.replace(f"<{element[1] or element[2] or element[3]}", f"<{rng.choice(names)}", 1)
    if rng.random() < 0.05:
        text = text.replace("?>", f"?>{DOCTYPE}", 1).replace('"hostile"', '"&c;"', 1)
    encoding = str(rng.choice(["utf-8"] * 20 + ["utf-16", "latin-1", "utf-7", "cp037"]))
    data = text.encode(encoding, errors="replace")
    return damaged(data, rng) if rng.random() < 0.05 else data


def hostile_binary(fmi: str, libraries: dict[str, bytes], rng: np.random.Generator) -> bytes:
    """Return an FMU with a binary that is none, or that of something else."""
    library = libraries[fmi]
    way = int(rng.integers(7))
    if way == 0:
        return fmu(fmi, library[: int(rng.integers(len(library)))])
    if way == 1:
        return fmu(fmi, rng.bytes(1000))
    if way == 2:
        return fmu(fmi, b"#!/bin/sh\ntouch /tmp/evil\n")
    if way == 3:
        return fmu(fmi, libraries["3.0" if fmi == "2.0" else "2.0"])
    if way == 4:  # a function goes by another name
        name = str(
            rng.choice(
                [b"DoStep", b"FreeInstance", b"GetVersion", b"ExitInitializationMode", b"GetReal", b"GetFloat64"]
            )[2:-1]
        )
        return fmu(fmi, library.replace(f"fmi{fmi[0]}{name}".encode(), f"fmj{fmi[0]}{name}".encode()))
    if way == 5:
        return fmu(
            fmi, None, entries=[("binaries/win64/hostile.dll", b"MZ"), ("binaries/x86_64-windows/hostile.dll", b"MZ")]
        )
    other = bytearray(library)
    other[18:20] = struct.pack("<H", int(rng.choice([3, 40, 183, 243])))  # of another processor
    return fmu(fmi, bytes(other))
