"""FMUs of other tools, run here and by fmpy: the same steps and inputs, and how far the results are apart.

Run it with ``python benchmarks/foreign_fmus.py FOLDER_OR_FMU... [--json FILE]``. Each FMU runs in a process of its own, in each
kind that it has, for 200 steps; its real inputs make a step after the 50th. It prints a table by exporter, as in
docs/other-tools.md, and what is refused, with the sentence.
"""

import argparse
import json
import re
import subprocess
import sys
import warnings
from collections import defaultdict
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
"""What generationTool has in it, and how the table calls that."""


def exporter(tool):
    """Return a short name for a generationTool."""
    return next((name for part, name in FAMILIES if part in tool), tool.split(",")[0][:30] or "not said")


def step_of(description):
    """Return the recommended step, or a five-hundredth of the default experiment."""
    said = description.default_experiment
    step = said.get("stepSize") or ((said.get("stopTime") or 1.0) - (said.get("startTime") or 0.0)) / 500
    return float(step) if float(step) > 0 else 0.01


def jumps(block):
    """Return for each real scalar input of a block its value before and after a small step, within its limits."""
    found = {}
    variables = {v.name: v for v in block.description.variables}
    for port in block.inputs:
        variable = variables[port.name]
        if port.shape or variable.type not in {"Real", "Float64", "Float32"} or variable.causality != "input":
            continue
        before = float(block.start_value(port.name))
        low, high = variable.bounds
        after = float(np.clip(before + 0.01 * max(1.0, abs(before)), low, high))
        found[port.name] = (before, after)
    return found


def ours(path, kind, step, tolerance):
    """Return the outputs by name, and the inputs' jumps."""
    from bayesftc import cosim

    settings = {"rtol": tolerance} if kind == "model exchange" else {}
    block = cosim.FMU(path, kind=kind, **settings)
    if kind == "co-simulation":
        block = cosim.FMU(path, kind=kind, timing="plant", outputs=names(block), **settings)
    else:
        block = cosim.FMU(path, kind=kind, outputs=names(block), **settings)
    diagram = cosim.Diagram(dt=step)
    plant = diagram.add(block, "p")
    moved = jumps(block)
    for number, (name, (before, after)) in enumerate(moved.items()):
        source = cosim.Step(time=JUMP * diagram.step, before=before, after=after)
        diagram.connect(diagram.add(source, f"u{number}")["y"], plant[name])
    result = diagram.simulate(STEPS * diagram.step, engine="interpreted")
    return {p.name: np.asarray(result[f"p.{p.name}"]) for p in block.outputs}, moved, float(diagram.step)


def names(block):
    """Return its outputs, or where it has none some of its local real variables."""
    if block.outputs:
        return [port.name for port in block.outputs]
    local = [v.name for v in block.description.variables if v.causality == "local" and v.type in {"Real", "Float64"}]
    return local[:10]


def fmpys(path, kind, step, tolerance, outputs, moved):
    """Return the same outputs as fmpy computes them; in its table two rows at one time hold an input until it jumps."""
    import fmpy

    start = {name: before for name, (before, _) in moved.items()}
    table = None
    if moved:
        rows = [(0.0, 0), (JUMP * step, 0), (JUMP * step, 1), (STEPS * step, 1)]
        values = [(t, *(pair[i] for pair in moved.values())) for t, i in rows]
        table = np.array(values, dtype=[("time", float), *((name, float) for name in moved)])
    found = fmpy.simulate_fmu(
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
    )
    return {name: np.asarray(found[name], float) for name in outputs}


def difference(mine, theirs):
    """Return the largest difference of any output, in units of that output's largest value."""
    worst = 0.0
    for name, values in mine.items():
        other = theirs[name].reshape(values.shape) if theirs[name].size == values.size else theirs[name]
        if other.shape != values.shape:
            return float("nan")
        both = np.isnan(values) & np.isnan(other)
        scale = max(np.nanmax(np.abs(other), initial=0.0), 1e-12)
        worst = max(worst, float(np.max(np.where(both, 0.0, np.abs(values - other)), initial=0.0)) / scale)
    return worst


def one(path, kind):
    """Run one FMU both ways; return what was seen."""
    from bayesftc import cosim
    from bayesftc.cosim.fmu import describe

    seen = {}
    warnings.simplefilter("ignore")
    description = describe(path)
    step = step_of(description)
    told = description.default_experiment.get("tolerance")
    tolerance = TIGHT if kind == "model exchange" else (None if told is None else float(told))
    mine = moved = None
    try:
        mine, moved, step = ours(path, kind, step, tolerance)
    except cosim.BayesFTCError as error:
        seen["refused"] = str(error)
    if mine is not None and not mine:
        seen["refused"] = "It has no output and no local variable to compare."
        return seen
    try:
        theirs = fmpys(path, kind, step, tolerance, mine or (), moved or {})
        if mine is not None:
            seen["difference"] = difference(mine, theirs)
        seen["fmpy"] = True
    except Exception as error:  # noqa: BLE001 - fmpy has no errors of its own
        seen["fmpy"] = f"{type(error).__name__}: {error}"
    return seen


def watched(path):
    """Run each kind of an FMU in a process of its own; return a row for each."""
    from bayesftc import cosim
    from bayesftc.cosim.fmu import describe

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
            row["refused"] = f"{kind} is no kind that is run here"
        rows.append(row)
    return rows


def table(rows):
    """Print rows by exporter in Markdown, then the sentences of refusals."""
    families = defaultdict(list)
    for row in rows:
        families[exporter(row["tool"])].append(row)
    print("| exporter | FMUs | kinds run | same as fmpy (1e-9) | largest difference | refused | runs in neither |")
    print("|---|---|---|---|---|---|---|")
    for family, members in sorted(families.items(), key=lambda item: -len(item[1])):
        compared = [row for row in members if row.get("difference") is not None]
        same = [row for row in compared if row["difference"] <= SAME]
        refused = [row for row in members if "refused" in row and row.get("fmpy") is True]
        neither = len(members) - len(compared) - len(refused)
        largest = max((row["difference"] for row in compared), default=None)
        print(
            f"| {family} | {len({row['file'] for row in members})} | {len(compared)} | {len(same)} | "
            f"{'' if largest is None else f'{largest:.1e}'} | {len(refused)} | {neither} |"
        )
    print()
    for row in rows:
        if row.get("difference", 0.0) > SAME or "difference" not in row:
            told = (
                row.get("refused")
                or row.get("crash")
                or (f"differs by {row['difference']:.1e}" if "difference" in row else "")
            )
            note = "" if row.get("fmpy") in {True, None} else f" [fmpy: {re.sub(chr(10), ' ', row['fmpy'])[:150]}]"
            print(f"- {row['file']} ({row['kind']}, {exporter(row['tool'])}): {told}{note}")


def main(arguments=None):
    """Compare what the command line names."""
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
