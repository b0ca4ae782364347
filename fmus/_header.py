"""The C header of one model for the wrapper: names, kinds, start values, token."""

from bayesftc.fmus.spec import Model, Variable

_KINDS = {
    ("input", "continuous"): "INPUT",
    ("input", "discrete"): "INPUT",
    ("output", "continuous"): "OUTPUT",
    ("output", "discrete"): "OUTPUT",
    ("local", "continuous"): "LOCAL",
    ("local", "discrete"): "LOCAL",
    ("parameter", "fixed"): "FIXED",
    ("parameter", "tunable"): "TUNABLE",
}


def _row(variable: Variable, offset: int) -> str:
    kind = _KINDS[variable.causality, variable.variability]
    return f'VARIABLE("{variable.name}", {kind}, {offset}, {variable.size})'


def _folded(macro: str, items: list[str]) -> list[str]:
    """Return the lines of a macro that is a list, with several items per line."""
    lines, line = [], "   "
    for item in items:
        if len(line) + len(item) > 110:
            lines.append(line)
            line = "   "
        line += f" {item},"
    return [f"#define {macro} \\", *(f"{each} \\" for each in lines), line.rstrip(",")]


def config_header(model: Model, token: str, *, time_variable: bool) -> str:
    """Write ``model_config.h``.

    Parameters
    ----------
    model : Model
        The model.
    token : str
        GUID (FMI 2) or instantiation token (FMI 3).
    time_variable : bool
        Whether the time is the last variable, as FMI 3 requires.

    Returns
    -------
    str
        The header's text.
    """
    rows = [_row(variable, model.offset(variable.name)) for variable in model.variables]
    if time_variable:
        rows.append(f'VARIABLE("time", INDEPENDENT, {model.size}, 1)')
    indices = [f"{variable.symbol} = {model.offset(variable.name)}" for variable in model.variables]
    indices += [f"X_TIME = {model.size}", "X_HIDDEN"]
    # repr gives the shortest decimal that is read as the same double, in C as in Python.
    starts = [repr(float(start)) for variable in model.variables for start in variable.starts]
    lines = [
        f"/* Written by bayesftc.fmus from the description of {model.name}: change that, not this. */",
        "#ifndef BAYESFTC_MODEL_CONFIG_H",
        "#define BAYESFTC_MODEL_CONFIG_H",
        "",
        f'#define MODEL_NAME "{model.name}"',
        f'#define MODEL_TOKEN "{token}"',
        f"#define MODEL_VARIABLES {len(rows)}",
        f"#define MODEL_HIDDEN {model.hidden}",
        f"#define MODEL_SIZE {model.size + 1 + model.hidden}",
        *([f"#define MODEL_FIXED_STEP {model.step!r}"] if model.fixed_step else []),
        "",
        "enum { " + ", ".join(indices) + " };",
        "",
        "#define MODEL_TABLE \\",
        *(f"    {row} \\" for row in rows[:-1]),
        f"    {rows[-1]}",
        "",
        *_folded("MODEL_STARTS", starts or ["0.0"]),
        "",
        "#endif",
    ]
    return "\n".join(lines) + "\n"
