"""Takes blocks away from Python: as an FMU that runs in any other tool, or as C for firmware."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import Literal

from bayesftc.cosim._export.c_file import write_c
from bayesftc.cosim._export.dependencies import feeding, keeps_state_in_outputs
from bayesftc.cosim._export.fmu import model_of
from bayesftc.cosim._export.program import Program, program_of
from bayesftc.cosim._opening import Names
from bayesftc.cosim.block import Block
from bayesftc.cosim.diagram import Diagram
from bayesftc.cosim.errors import ModelError


def export_fmu(
    exported: Block | Diagram,
    path: str | PathLike[str],
    *,
    fmi: Literal["2.0", "3.0"] = "2.0",
    platforms: Sequence[str] | str | None = None,
    blocks: Sequence[str] | str | None = None,
    inputs: Names | None = None,
    outputs: Names | None = None,
    dt: float | str | Fraction | None = None,
    timing: Literal["plant", "sampled"] | None = None,
    description: str = "",
) -> Path:
    """Write a block, or some blocks of a diagram, as an FMU for co-simulation that needs no Python.

    Parameters
    ----------
    exported : Block or Diagram
        What to export.
    path : str or path
        The file to write; its stem becomes the model's name.
    fmi : {"2.0", "3.0"}
        Version of the standard. Vectors are arrays in FMI 3, and one variable for each element in FMI 2: ``y[0]``, ``y[1]``.
    platforms : sequence of str, optional
        For which the FMU gets binaries, besides its C sources; by default this machine's.
    blocks : sequence of str, optional
        Names of the blocks of a diagram that become one FMU; by default all. An FMU cannot be among them.
    inputs, outputs : sequence of str or mapping of str to str, optional
        The signals that the outside sees; a mapping gives each a new name. By default all inputs that nothing within feeds,
        random ones too, and all outputs; called as their ports, the block's name before it where there are several blocks.
    dt : float, str or Fraction, optional
        The sample time of a block that has none of its own.
    timing : {"plant", "sampled"}, optional
        When the outputs hold. Sampled: a step takes the inputs at its beginning, and the outputs after it are those computed
        from them, as a controller's must be. Plant: they are those at the end of the step; only where no input acts on an output
        directly. By default what fits.
    description : str
        A sentence or two for the user of the FMU.

    Returns
    -------
    pathlib.Path
        The FMU.

    Raises
    ------
    KernelError
        If a step function cannot become C; the sentence names the line.
    ModelError
        If something in it is an FMU or calls back into Python, or the settings do not fit.
    """
    from bayesftc.fmus.build import build_fmu

    target = Path(path)
    program = program_of(exported, name=target.stem, blocks=blocks, inputs=inputs, outputs=outputs, dt=dt)
    model = model_of(program, write_c(program), _timing(program, timing), description)
    with tempfile.TemporaryDirectory(prefix="bayesftc-", dir=target.parent) as scratch:
        built = build_fmu(model, Path(scratch), fmi=fmi)
        built.replace(target)
    return target


def _timing(program: Program, asked: Literal["plant", "sampled"] | None) -> Literal["plant", "sampled"]:
    names = {signal.name for signal in program.inputs}
    direct = next(((output, sorted(by & names)) for output, by in feeding(program).items() if by & names), None)
    if direct is None and not keeps_state_in_outputs(program):
        return asked or "plant"
    if asked == "plant":
        why = (
            f"the input {direct[1][0]!r} acts on the output {direct[0]!r} directly"
            if direct
            else "computing outputs changes a state"
        )
        raise ModelError(f"{program.name} cannot be exported with timing='plant': {why}; leave it 'sampled'.")
    return "sampled"
