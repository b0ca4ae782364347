"""The C header that tells the wrapper about one model: names, kinds, start values, token."""

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


def _row(variable: Variable) -> str:
    # repr gives the shortest decimal that reads back as the same double, in C as in Python.
    return f'VARIABLE("{variable.name}", {_KINDS[variable.causality, variable.variability]}, {variable.start!r})'


def config_header(model: Model, token: str, *, time_variable: bool) -> str:
    """Write ``model_config.h``.

    Parameters
    ----------
    model : Model
        The model.
    token : str
        GUID (FMI 2) or instantiation token (FMI 3).
    time_variable : bool
        Whether importers see the time as a variable, as FMI 3 asks; it is the last one.

    Returns
    -------
    str
        The header's text.
    """
    count = len(model.variables)
    rows = [_row(variable) for variable in model.variables]
    if time_variable:
        rows.append('VARIABLE("time", INDEPENDENT, 0.0)')
    indices = [*(variable.symbol for variable in model.variables), "X_TIME", "X_HIDDEN"]
    lines = [
        f"/* Written by bayesftc.fmus from the description of {model.name}: change that, not this. */",
        "#ifndef BAYESFTC_MODEL_CONFIG_H",
        "#define BAYESFTC_MODEL_CONFIG_H",
        "",
        f'#define MODEL_NAME "{model.name}"',
        f'#define MODEL_TOKEN "{token}"',
        f"#define MODEL_VARIABLES {len(rows)}",
        f"#define MODEL_HIDDEN {model.hidden}",
        f"#define MODEL_SIZE {count + 1 + model.hidden}",
        *([f"#define MODEL_FIXED_STEP {model.step!r}"] if model.fixed_step else []),
        "",
        "enum { " + ", ".join(indices) + " };",
        "",
        "#define MODEL_TABLE \\",
        *(f"    {row} \\" for row in rows[:-1]),
        f"    {rows[-1]}",
        "",
        "#endif",
    ]
    return "\n".join(lines) + "\n"
