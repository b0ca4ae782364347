"""FMUs of other tools, run here and with fmpy: the same steps and inputs, and the differences of the results.

Run it with ``python benchmarks/foreign_fmus.py FOLDER_OR_FMU... [--json FILE]``. Each FMU runs in a separate process, in each of
its kinds, for 200 steps; its real inputs change at the 50th step. It prints a table by exporter, as in
docs/reports/other-tools.md, and the FMUs that do not run, with the message.
"""

import argparse
import json
import subprocess
import sys
import warnings
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

STEPS, JUMP = 200, 50
SAME = 1e-9
TIGHT = 1e-10
"""The relative tolerance of both integrators for model exchange."""
LIMIT = 120.0
KINDS = {"coSimulation": "co-simulation", "modelExchange": "model exchange"}
FAMILIES = (
    ("OpenModelica", "OpenModelica"),
    ("Dymola", "Dymola"),
    ("JModelica", "JModelica.org"),
    ("FMI Kit", "Simulink, FMI Kit"),
    ("Hopsan", "Hopsan"),
    ("20-sim", "20-sim"),
    ("Parker", "Parker Hannifin's own"),
    ("PythonFMU3", "PythonFMU3"),
    ("PythonFMU", "PythonFMU"),
    ("Reference FMUs", "Reference FMUs"),
    ("CasADi", "CasADi"),
    ("FMUContainer", "FMU containers"),
)
"""A part of generationTool, and the name in the table."""


def exporter(tool):
    """Return a short name for a generationTool."""
    return next((name for part, name in FAMILIES if part in tool), tool.split(",")[0][:30] or "not said")


def step_of(path, description):
    """Return the step that the FMU requires or recommends, or a five-hundredth of its default experiment."""
    import fmpy

    experiment = description.default_experiment
    demanded = getattr(
        fmpy.read_model_description(str(path), validate=False).coSimulation, "fixedInternalStepSize", None
    )
    long = (experiment.get("stopTime") or 1.0) - (experiment.get("startTime") or 0.0)
    step = float(demanded or experiment.get("stepSize") or long / 500)
    return step if step > 0 else 0.01


def by_hand(path, step, outputs, moved):
    """Return the outputs from fmpy's binding of FMI 2 with the same calls as here, with times as the nearest doubles."""
    import fmpy
    from fmpy.fmi2 import FMU2Slave

    from bayesftc.cosim.base.timebase import rational_step

    exact = rational_step(step)
    model = fmpy.read_model_description(str(path), validate=False)
    references = {v.name: v.valueReference for v in model.modelVariables}
    identifier, guid = model.coSimulation.modelIdentifier, model.guid
    slave = FMU2Slave(guid=guid, unzipDirectory=fmpy.extract(str(path)), modelIdentifier=identifier, instanceName="p")
    tolerance = getattr(model.defaultExperiment, "tolerance", None)
    slave.instantiate()
    slave.setupExperiment(tolerance=None if tolerance is None else float(tolerance), startTime=0.0)

    def put(after):
        for name, pair in moved.items():
            slave.setReal([references[name]], [pair[after]])

    put(False)
    slave.enterInitializationMode()
    put(False)
    slave.exitInitializationMode()
    rows = []
    for k in range(STEPS + 1):
        rows.append([slave.getReal([references[name]])[0] for name in outputs])
        if k < STEPS:
            put(k >= JUMP)
            slave.doStep(float(k * exact), step)
    slave.terminate()
    slave.freeInstance()
    return dict(zip(outputs, np.array(rows).T, strict=True))


def euler(path, step, block, moved):
    """Return the outputs of a model exchange FMU with Euler's method, from its equations as read by this package."""
    from bayesftc.cosim import ModelEquations

    with ModelEquations(block) as model:
        x, rows = model.x0.copy(), []
        for k in range(STEPS + 1):
            u = model.u0.copy()
            for name, pair in moved.items():
                u[model.input_names.index(name)] = pair[k >= JUMP]
            rows.append(model.outputs(x, u, k * step))
            x = x + step * model.derivatives(x, u, k * step)
        return dict(zip(model.output_names, np.array(rows).T, strict=True))


def jumps(block):
    """Return the values of each real scalar input of a block before and after a small step, within its limits."""
    values = {}
    variables = {v.name: v for v in block.description.variables}
    for port in block.inputs:
        variable = variables[port.name]
        if port.shape or variable.type not in {"Real", "Float64", "Float32"} or variable.causality != "input":
            continue
        before = float(block.start_value(port.name))
        low, high = variable.bounds
        after = float(np.clip(before + 0.01 * max(1.0, abs(before)), low, high))
        values[port.name] = (before, after)
    return values


def block_of(path, kind, tolerance):
    """Return the FMU as a block with the compared outputs."""
    from bayesftc import cosim

    settings = {"rtol": tolerance} if kind == "model exchange" else {"timing": "plant"}
    return cosim.FMU(path, kind=kind, outputs=names(cosim.FMU(path, kind=kind)), **settings)


def ours(block, step, moved):
    """Return the outputs by name."""
    from bayesftc import cosim

    diagram = cosim.Diagram(dt=step)
    plant = diagram.add(block, "p")
    for number, (name, (before, after)) in enumerate(moved.items()):
        source = cosim.Step(time=JUMP * step, before=before, after=after)
        diagram.connect(diagram.add(source, f"u{number}")["y"], plant[name])
    result = diagram.simulate(STEPS * diagram.step, engine="interpreted")
    return {p.name: np.asarray(result[f"p.{p.name}"]) for p in block.outputs}


def names(block):
    """Return the names of its outputs, or if it has none, of some local real variables."""
    if block.outputs:
        return [port.name for port in block.outputs]
    local = [v.name for v in block.description.variables if v.causality == "local" and v.type in {"Real", "Float64"}]
    return local[:10]


def fmpys(path, kind, step, tolerance, outputs, moved, solver="CVode"):
    """Return the same outputs from fmpy; two rows of its table at the same time make an input jump."""
    import fmpy

    start = {name: before for name, (before, _) in moved.items()}
    table = None
    if moved:
        rows = [(0.0, 0), (JUMP * step, 0), (JUMP * step, 1), (STEPS * step, 1)]
        values = [(t, *(pair[i] for pair in moved.values())) for t, i in rows]
        table = np.array(values, dtype=[("time", float), *((name, float) for name in moved)])
    result = fmpy.simulate_fmu(
        str(path),
        validate=False,
        fmi_type=kind.title().replace("-", "").replace(" ", ""),
        start_time=0.0,
        stop_time=STEPS * step,
        output_interval=step,
        input=table,
        start_values=start,
        output=list(outputs),
        record_events=False,
        relative_tolerance=tolerance,
        set_stop_time=False,
        solver=solver,
        step_size=step,
    )
    return {name: np.asarray(result[name], float) for name in outputs}


def difference(own_outputs, theirs):
    """Return the largest difference of an output, relative to that output's largest value."""
    worst = 0.0
    for name, values in own_outputs.items():
        other = theirs[name]
        rows = min(len(values), len(other))  # if an FMU ends the simulation, only one of the two may have the last step
        if max(len(values), len(other)) > rows + 1 or values[:rows].size != other[:rows].size:
            return float("nan")
        values, other = values[:rows].ravel(), other[:rows].ravel()
        both = np.isnan(values) & np.isnan(other)
        scale = max(np.nanmax(np.abs(other), initial=0.0), 1e-12)
        worst = max(worst, float(np.max(np.where(both, 0.0, np.abs(values - other)), initial=0.0)) / scale)
    return worst


def one(path, kind):
    """Run one FMU in both ways and return the results."""
    from bayesftc import cosim
    from bayesftc.cosim.fmi.fmu import describe

    warnings.simplefilter("ignore")
    description = describe(path)
    step, report = step_of(path, description), {}
    default = description.default_experiment.get("tolerance")
    tolerance = TIGHT if kind == "model exchange" else (None if default is None else float(default))
    own_outputs, moved = {}, {}
    try:
        block = block_of(path, kind, tolerance)
        if not block.outputs:
            return {"nothing": "it has no numeric output and no local real variable to compare"}
        moved = jumps(block)
        try:
            own_outputs = ours(block, step, moved)
        except cosim.BayesFTCError as error:
            if not moved:
                raise
            report["inputs"] = f"left alone: {error}"
            moved, block = {}, replace(block, inputs=[])
            own_outputs = ours(block, step, moved)
    except cosim.BayesFTCError as error:
        report["refused"] = str(error)
    try:
        theirs = fmpys(path, kind, step, tolerance, own_outputs, moved)
        report["fmpy"] = True
    except Exception as error:  # noqa: BLE001 - fmpy has no error classes
        return report | {"fmpy": f"{type(error).__name__}: {error}", "here": bool(own_outputs)}
    if not own_outputs:
        return report
    report["difference"] = difference(own_outputs, theirs)
    if kind == "model exchange" and report["difference"] > SAME:
        same = fmpys(path, kind, step, tolerance, own_outputs, moved, solver="Euler")
        report |= {"cvode": report["difference"], "difference": difference(euler(path, step, block, moved), same)}
    elif report["difference"] > SAME and description.fmi_version.startswith("2"):
        report |= {
            "simulate_fmu": report["difference"],
            "difference": difference(own_outputs, by_hand(path, step, own_outputs, moved)),
        }
    return report


def watched(path):
    """Run each kind of an FMU in a separate process; return a row for each."""
    from bayesftc import cosim
    from bayesftc.cosim.fmi.fmu import describe

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            description = describe(path)
        except cosim.BayesFTCError as error:
            return [{"file": path.name, "tool": "", "kind": "", "fmi": "", "refused": str(error)}]
    rows = []
    for kind in description.kinds:
        row = {"file": path.name, "tool": description.generation_tool or "", "fmi": description.fmi_version}
        row["kind"] = KINDS.get(kind, kind)
        if kind in KINDS:
            command = [sys.executable, __file__, "--one", str(path), "--kind", KINDS[kind]]
            try:
                done = subprocess.run(
                    command, capture_output=True, text=True, timeout=LIMIT, check=False, errors="replace"
                )
                last = [line for line in done.stdout.splitlines() if line.startswith('{"')]
                row |= (
                    json.loads(last[-1]) if last else {"crash": f"ended with {done.returncode}: {done.stderr[-300:]}"}
                )
            except subprocess.TimeoutExpired:
                row["crash"] = f"took longer than {LIMIT:.0f} s"
        else:
            row["refused"] = f"{kind} is not supported"
        rows.append(row)
    return rows


def table(rows):
    """Print rows by exporter in Markdown, then the differences and messages."""
    families = defaultdict(list)
    for row in rows:
        families[exporter(row["tool"])].append(row)
    print(
        "| exporter | FMUs | run in both | the same to 1e-9 | largest difference | run here only | in fmpy only | in neither |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for family, members in sorted(families.items(), key=lambda item: (-len(item[1]), item[0])):
        compared = [row["difference"] for row in members if row.get("difference") is not None]
        refused = [row for row in members if "refused" in row and row.get("fmpy") is True]
        files = len({row["file"] for row in members})
        here = sum(row.get("here", False) for row in members)
        neither = sum("difference" not in row and "nothing" not in row for row in members) - len(refused) - here
        same = sum(value <= SAME for value in compared)
        largest = f"{max(compared):.1e}" if compared else ""
        print(f"| {family} | {files} | {len(compared)} | {same} | {largest} | {here} | {len(refused)} | {neither} |")
    print()
    for row in rows:
        apart = {
            name: f"{row[name]:.1e}" for name in ("difference", "simulate_fmu", "cvode") if row.get(name, 0.0) > SAME
        }
        words = [row[name] for name in ("refused", "crash", "nothing") if name in row]
        words += [f"inputs {row['inputs']}"] if "inputs" in row and "refused" not in row else []
        if isinstance(row.get("fmpy"), str):
            words.append(f"fmpy: {' '.join(row['fmpy'].split())[:150]}")
        if apart or words:
            print(f"- {row['file']} ({row['kind']}, {exporter(row['tool'])}): {apart or ''} {'; '.join(words)}")


def main(arguments=None):
    """Compare the FMUs of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("paths", nargs="*", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--one", type=Path)
    parser.add_argument("--kind")
    options = parser.parse_args(arguments)
    if options.one:
        print("\n" + json.dumps(one(options.one, options.kind)))
        return
    files = sorted({f for path in options.paths for f in ([path] if path.is_file() else path.rglob("*.fmu"))})
    rows = []
    for file in files:
        rows += watched(file)
        print(f"{len(rows)}: {file.name}", file=sys.stderr, flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))
    table(rows)


if __name__ == "__main__":
    main()
