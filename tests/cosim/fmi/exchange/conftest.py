"""FMUs of FMI 1, 2 and 3 for the tests of model exchange, built of models.c and fmi1.c at their first use."""

import inspect
import re
import subprocess
import zipfile
from pathlib import Path

import pytest

HERE = Path(__file__).parent

X, P = ("local", "continuous", "calculated"), ("parameter", "fixed", "exact")
U, D = ("input", "continuous", None), ("input", "discrete", None)
Y, N = ("output", "continuous", "calculated"), ("output", "discrete", "calculated")
T = ("parameter", "tunable", "exact")
SLOPE = {"der(x)": "x"}
STATE = [("x", 0, ("output", "continuous", "exact"), 0.0), ("der(x)", 2, X, None)]
# Of each model: variables as (name, value reference, kind, start) and, unless they are of Real or Float64, type; states by
# derivative, event indicators, dependencies of outputs on inputs, and whether it wants completed steps. What the models are is at
# the top of models.c.
MODELS = {
    "ball": ([("h", 0, Y, None), ("v", 1, X, None), ("der(h)", 2, X, None), ("der(v)", 3, X, None), ("g", 10, P, 9.81),
              ("e", 11, P, 0.7), ("vmin", 12, P, 0.1)], {"der(h)": "h", "der(v)": "v"}, 1, {"h": []}, False),
    "heater": ([("T", 0, X, None), ("der(T)", 2, X, None), ("Ta", 4, U, 10.0), ("on", 6, N, None), ("y", 7, Y, None),
                ("low", 10, P, 19.0), ("high", 11, P, 21.0), ("P", 12, P, 20.0), ("tau", 13, P, 5.0)],
               {"der(T)": "T"}, 2, {"on": [], "y": ["Ta"]}, False),
    "pulse": ([("x", 0, Y, None), ("der(x)", 2, X, None), ("period", 10, P, 0.1)], {"der(x)": "x"}, 0, {"x": []}, False),
    "relay": ([("x", 0, Y, None), ("der(x)", 2, X, None), ("u", 4, U, 0.0)], {"der(x)": "x"}, 1, {"x": []}, False),
    "counter": ([("x", 0, Y, None), ("der(x)", 2, X, None), ("n", 6, N, None)], {"der(x)": "x"}, 0, {"x": [], "n": []}, True),
    "gate": ([("u", 4, U, 0.0), ("d", 5, D, 0.0), ("n", 6, N, None), ("y", 7, Y, None)], {}, 0, {"n": [], "y": None}, False),
    "clock": ([("n", 6, N, None)], {}, 0, {"n": []}, False),
    "lag": ([("x", 0, ("local", "continuous", "exact"), "1 2 3"), ("der(x)", 2, X, None), ("u", 4, U, "0 0 0"),
             ("y", 7, Y, None)], {"der(x)": "x"}, 0, {"y": []}, False),
    "edge": ([*STATE, ("u", 4, U, 1.0), ("n", 6, N, None)], SLOPE, 1, {"x": [], "n": []}, False),
    "fine": ([*STATE, ("w", 10, P, 1e-7)], SLOPE, 2, {"x": []}, False),
    "wild": ([("x", 0, Y, None), ("der(x)", 2, X, None), ("how", 10, P, 0.0)], SLOPE, 1, {"x": []}, False),
    "stack": ([*STATE, ("n", 6, N, None), ("at", 10, P, 0.5)], SLOPE, 0, {"x": [], "n": []}, False),
    "count": (STATE, SLOPE, 0, {"x": []}, False),
    "slide": ([("x", 0, Y, None), ("v", 1, Y, None), ("der(x)", 2, X, None), ("der(v)", 3, X, None)],
              {"der(x)": "x", "der(v)": "v"}, 2, {"x": [], "v": []}, False),
    "scale": ([("x", 0, Y, None), ("der(x)", 2, X, None), ("quiet", 10, P, 0.0)], SLOPE, 0, {"x": []}, False),
    "quits": ([*STATE, ("now", 10, P, 0.0)], SLOPE, 0, {"x": []}, True),
    "alarm": ([("n", 6, N, None), ("when", 8, N, None)], {}, 1, {"n": [], "when": []}, False),
    "tuned": ([("x", 0, Y, None), ("der(x)", 2, X, None), ("k", 25, T, 1.0)], SLOPE, 0, {"x": []}, False),
    "fails": ([("x", 0, Y, None), ("der(x)", 2, X, None), ("status", 10, P, 3.0)], SLOPE, 0, {"x": []}, False),
    "pol": ([("x", 0, Y, None), ("v", 1, X, None), ("der(x)", 2, X, None), ("der(v)", 3, X, None), ("mu", 10, P, 1000.0)],
            {"der(x)": "x", "der(v)": "v"}, 0, {"x": []}, False),
} | {
    name: ([("x", 0, Y, None), ("der(x)", 2, X, None)], {"der(x)": "x"}, 0, {"x": []}, False)
    for name in ("endless", "ends", "nan", "past")
}  # fmt: skip


def blank(fmi):
    """Return the model that does not write, as the others are given: one of its outputs is a whole number."""
    n = ("n", 39, N, None, "Int32" if fmi == "3.0" else "Integer")
    return [*STATE, n, ("what", 10, P, 0.0)], SLOPE, 1, {"x": [], "n": []}, False


OLD_TYPES = {"i32": ("Integer", 19), "b": ("Boolean", 23), "e": ("Enumeration", 24)}
TYPES = {"1.0": OLD_TYPES, "2.0": OLD_TYPES,
         "3.0": {"s": ("Float32", 14), "i8": ("Int8", 15), "u8": ("UInt8", 16), "i16": ("Int16", 17), "u16": ("UInt16", 18),
                 "i32": ("Int32", 19), "u32": ("UInt32", 20), "i64": ("Int64", 21), "u64": ("UInt64", 22),
                 "b": ("Boolean", 23), "e": ("Enumeration", 24), "a": ("Int32", 27)}}  # fmt: skip
"""The inputs of the model that has them of every type; each has an output that shows it."""


def typed(fmi):
    """Return the model with inputs, tunable parameters and outputs of all types of a version, as the others are given."""
    zero = {"Boolean": "false", "Enumeration": 1, "Float32": 0.0}
    inputs = []
    for name, (kind, number) in TYPES[fmi].items():
        start = "0 0" if name == "a" else zero.get(kind, 0)
        inputs.append((name, number, ("input", "continuous" if kind == "Float32" else "discrete", None), start, kind))
    outputs = [(f"{name}_out", number + 20, N, None, kind) for name, number, _, _, kind in inputs]
    variables = [
        *STATE, ("u", 4, U, 0.0), ("y", 7, Y, None), *inputs, *outputs, ("k", 25, T, 1.0),
        ("m", 26, T, 0, "Int32" if fmi == "3.0" else "Integer"),
    ]  # fmt: skip
    return (
        variables,
        SLOPE,
        0,
        {"x": [], "y": ["s"] if fmi == "3.0" else [], **{name: None for name, *_ in outputs}},
        False,
    )


def given(model, fmi):
    """Return what is said of a model."""
    return {"typed": typed, "blank": blank}[model](fmi) if model in {"typed", "blank"} else MODELS[model]


LEVELS = '<Item name="off" value="1"/><Item name="on" value="2"/>'
ITEMS = {
    "2.0": f'<SimpleType name="Mode"><Enumeration>{LEVELS}</Enumeration></SimpleType>',
    "3.0": f'<EnumerationType name="Mode">{LEVELS}</EnumerationType>',
}


def description1(model, save):
    variables, derivatives, indicators, through, _ = given(model, "1.0")
    rows = []
    for name, reference, (causality, variability, _), start, *kind in variables:
        fixed = causality == "parameter"
        told = through.get(name)
        names = (
            "" if told is None else f"<DirectDependency>{''.join(f'<Name>{n}</Name>' for n in told)}</DirectDependency>"
        )
        says = f' start="{start}"' if start is not None else ""
        of = ' declaredType="Mode"' if kind == ["Enumeration"] else ""
        rows.append(
            f'<ScalarVariable name="{name}" valueReference="{reference}" variability="{"parameter" if fixed else variability}" '
            f'causality="{"internal" if fixed or causality == "local" else causality}"><{kind[0] if kind else "Real"}{says}'
            f"{of}/>"
            f"{names if causality == 'output' else ''}</ScalarVariable>"
        )
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="1.0" modelName="{model}" guid="{model}" '
        f'modelIdentifier="models" numberOfContinuousStates="{len(derivatives)}" numberOfEventIndicators="{indicators}">'
        '<TypeDefinitions><Type name="Mode"><EnumerationType><Item name="off"/><Item name="on"/></EnumerationType></Type>'
        f"</TypeDefinitions><ModelVariables>{''.join(rows)}</ModelVariables></fmiModelDescription>"
    )


def description2(model, save):
    variables, derivatives, indicators, through, steps = given(model, "2.0")
    index = {name: i for i, (name, *_) in enumerate(variables, 1)}
    rows = []
    for name, reference, (causality, variability, initial), start, *kind in variables:
        initial = f' initial="{initial}"' if initial else ""
        of = ' declaredType="Mode"' if kind == ["Enumeration"] else ""
        of += (f' start="{start}"' if start is not None else "") + (
            f' derivative="{index[derivatives[name]]}"' if name in derivatives else ""
        )
        rows.append(
            f'<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}" '
            f'variability="{variability}"{initial}><{kind[0] if kind else "Real"}{of}/></ScalarVariable>'
        )

    def unknown(name, names):
        says = "" if names is None else f' dependencies="{" ".join(str(index[n]) for n in names)}"'
        return f'<Unknown index="{index[name]}"{says}/>'

    outputs = "".join(unknown(name, names) for name, names in through.items())
    derived = "".join(f'<Unknown index="{index[name]}"/>' for name in derivatives)
    first = {name for name, _, kind, *_ in variables if kind[2] == "calculated"}
    unknowns = "".join(f'<Unknown index="{index[name]}"/>' for name in sorted(first, key=index.get))
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="{model}" guid="{model}" '
        f'numberOfEventIndicators="{indicators}"><ModelExchange modelIdentifier="models" '
        f'completedIntegratorStepNotNeeded="{str(not steps).lower()}" canGetAndSetFMUstate="{save}" '
        f'canSerializeFMUstate="{save}"/><TypeDefinitions>{ITEMS["2.0"]}</TypeDefinitions>'
        f'<LogCategories><Category name="logStatusError"/></LogCategories>'
        f"<ModelVariables>{''.join(rows)}</ModelVariables><ModelStructure><Outputs>{outputs}</Outputs>"
        f"{f'<Derivatives>{derived}</Derivatives>' if derived else ''}"
        f"<InitialUnknowns>{unknowns}</InitialUnknowns></ModelStructure></fmiModelDescription>"
    )


def description3(model, save):
    variables, derivatives, indicators, through, steps = given(model, "3.0")
    reference = {name: number for name, number, *_ in variables}
    rows = ['<Float64 name="time" valueReference="99" causality="independent" variability="continuous"/>']
    for name, number, (causality, variability, initial), start, *kind in variables:
        more = (f' initial="{initial}"' if initial else "") + (f' start="{start}"' if start is not None else "")
        more += f' derivative="{reference[derivatives[name]]}"' if name in derivatives else ""
        more += ' declaredType="Mode"' if kind == ["Enumeration"] else ""
        size = (
            '<Dimension start="3"/>' if model == "lag" else '<Dimension start="2"/>' if name in {"a", "a_out"} else ""
        )
        what = kind[0] if kind else "Float64"
        rows.append(
            f'<{what} name="{name}" valueReference="{number}" causality="{causality}" variability="{variability}"{more}>'
            f"{size}</{what}>"
        )
    rows += [
        f'<Float64 name="z{i}" valueReference="{80 + i}" causality="local" variability="continuous" initial="calculated"/>'
        for i in range(indicators)
    ]

    def unknown(kind, name, names=None):
        says = "" if names is None else f' dependencies="{" ".join(str(reference[n]) for n in names)}"'
        return f'<{kind} valueReference="{reference[name]}"{says}/>'

    structure = "".join(unknown("Output", name, names) for name, names in through.items())
    structure += "".join(unknown("ContinuousStateDerivative", name) for name in derivatives)
    structure += "".join(unknown("InitialUnknown", name) for name, _, kind, *_ in variables if kind[2] == "calculated")
    structure += "".join(f'<EventIndicator valueReference="{80 + i}"/>' for i in range(indicators))
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="3.0" modelName="{model}" '
        f'instantiationToken="{model}"><ModelExchange modelIdentifier="models" '
        f'needsCompletedIntegratorStep="{str(steps).lower()}" canGetAndSetFMUState="{save}" canSerializeFMUState="{save}"/>'
        f"<TypeDefinitions>{ITEMS['3.0']}</TypeDefinitions>"
        f'<LogCategories><Category name="logStatusError"/></LogCategories><ModelVariables>{"".join(rows)}</ModelVariables>'
        f"<ModelStructure>{structure}</ModelStructure></fmiModelDescription>"
    )


@pytest.fixture(scope="session")
def binary(tmp_path_factory, c_compiler):
    import fmpy
    from fmpy.fmi3 import FMU3Model

    compiler = c_compiler
    folder = tmp_path_factory.mktemp("models")
    text = (HERE / "models.c").read_text()
    names = [name for name, _ in inspect.getmembers(FMU3Model) if name.startswith("fmi3")]
    absent = [name for name in names if not re.search(rf"\b{name}\b", text)]
    (folder / "absent.c").write_text("".join(f"int {name}(void) {{ return 3; }}\n" for name in absent))
    headers = Path(fmpy.__file__).parent / "c-code"
    library = folder / f"models{fmpy.sharedLibraryExtension}"
    flags = ["-shared", "-fPIC", "-O2", "-w", "-ffp-contract=off", f"-I{headers}"]
    subprocess.run(
        [compiler, *flags, str(HERE / "fmi1.c"), str(folder / "absent.c"), "-o", str(library), "-lm"], check=True
    )
    return library


@pytest.fixture(scope="session")
def built(binary, tmp_path_factory):
    """Return the path of a test FMU, built at its first use."""
    import fmpy

    folder, ready = tmp_path_factory.mktemp("fmus"), {}

    def path(model, fmi="2.0", save="true"):
        if (model, fmi, save) not in ready:
            target = folder / f"{model}{fmi[0]}{save}.fmu"
            platform = fmpy.platform_tuple if fmi == "3.0" else fmpy.platform
            described = {"1.0": description1, "2.0": description2, "3.0": description3}[fmi]
            with zipfile.ZipFile(target, "w") as archive:
                archive.writestr("modelDescription.xml", described(model, save))
                archive.write(binary, f"binaries/{platform}/{binary.name}")
            ready[model, fmi, save] = target
        return ready[model, fmi, save]

    return path


@pytest.fixture(scope="session")
def pendulum(casadi_fmu):
    """Return a pendulum that CasADi has exported: q'' = -9.81 sin q - 0.1 q' + u, y = q + 0.5 u, q(0) = 0.5."""
    return casadi_fmu("pendulum", lambda q, u: q + 0.5 * u)
