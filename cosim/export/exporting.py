"""Export blocks for use without Python: as an FMU for any other tool, or as C for firmware."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import Literal

from bayesftc.cosim.base.announcing import reported, tell
from bayesftc.cosim.base.paths import expanded
from bayesftc.cosim.base.temporary import BESIDE, temporary_folder
from bayesftc.cosim.block import Block
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.opening import Names
from bayesftc.cosim.errors import FMUError, ModelError, ResultFileError, brief
from bayesftc.cosim.export.c_file import write_c
from bayesftc.cosim.export.fmu import late_outputs, model_of
from bayesftc.cosim.export.names import program_name
from bayesftc.cosim.export.platforms import platforms_of
from bayesftc.cosim.export.program import program_of

_LONGEST = 200
"""Most bytes of an FMU's file name; slightly longer names are derived from it."""


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
    stop_time: float | None = None,
) -> Path:
    """Write a block, or some blocks of a diagram, as an FMU for co-simulation that needs no Python.

    Parameters
    ----------
    exported : Block or Diagram
        The block, or the diagram with the blocks, to export.
    path : str or path
        The file to write. Its stem becomes the model's name, spelt as C allows it (``Regler 1.fmu``: ``Regler_1``). An existing
        file is replaced at the end.
    fmi : {"2.0", "3.0"}
        Version of the standard. Vectors are arrays in FMI 3, and one variable for each element in FMI 2: ``y[0]``, ``y[1]``.
    platforms : sequence of str, optional
        Platforms of the FMU's binaries, which are added to its C sources: ``"linux-x86_64"``, ``"linux-aarch64"``,
        ``"windows-x86_64"``, ``"macos-x86_64"``, ``"macos-aarch64"``, or ``"all"``. Given platforms are compiled by ``ziglang``
        (``pip install 'bayesftc[export]'``) for old systems (glibc 2.17, macOS 11), to the same bytes on any machine. The first
        use for a platform takes minutes. By default this machine's platform, by its C compiler if there is one.
    blocks : sequence of str, optional
        Names of the blocks of a diagram that become one FMU; by default all. An FMU cannot be among them.
    inputs, outputs : sequence of str or mapping of str to str, optional
        The inputs and outputs of the FMU; a mapping gives new names. By default all unconnected inputs, including random ones,
        and all outputs. They have the names of their ports, with the block's name before it if there are several blocks.
    dt : float, str or Fraction, optional
        The sample time, for a block that does not define one.
    timing : {"plant", "sampled"}, optional
        The instant that the outputs belong to. Sampled: the outputs after a step are computed from the inputs at the beginning of
        the step, as for a controller. Plant: the outputs after a step are those at the end of the step. This is possible only if
        no input acts on an output directly. The default is plant where possible.
    description : str
        A sentence or two for the user of the FMU.
    stop_time : float, optional
        Seconds for which an importer simulates the FMU by default, up to the next whole step; by default 20 s, or 100 steps if
        these are longer.

    Returns
    -------
    pathlib.Path
        The FMU.

    Raises
    ------
    KernelError
        If a step function cannot be translated to C; the message names the line.
    ModelError
        If a block is an FMU or calls Python, or the settings are not valid.
    FMUError
        If there is no C compiler for a platform, or it fails.
    ResultFileError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from bayesftc import cosim
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = cosim.export_fmu(cosim.Saturation(-1.0, 1.0), f"{folder}/limit.fmu", dt=0.01)
    ...     print(cosim.FMU(path))
    <FMU limit.fmu, co-simulation, timing='sampled': u -> y>
    """
    from bayesftc.fmus.build import FMI_VERSIONS, build_fmu

    target = fmu_file(path)
    if fmi not in FMI_VERSIONS:
        raise ModelError(f"export_fmu has fmi={fmi!r}; it must be one of {', '.join(map(repr, FMI_VERSIONS))}.")
    if timing not in (None, "plant", "sampled"):
        raise ModelError(f"export_fmu has timing={timing!r}; it must be 'plant' or 'sampled'.")
    if not isinstance(description, str) or not all(letter.isprintable() or letter.isspace() for letter in description):
        raise ModelError(
            f"export_fmu has description={brief(description)}; it must be a string without control characters."
        )
    if stop_time is not None and not 0 < stop_time < float("inf"):
        raise ModelError(f"export_fmu has stop_time={stop_time!r}; it must be a positive number of seconds.")
    requested = platforms_of(platforms)
    program = program_of(exported, name=program_name(target.stem), blocks=blocks, inputs=inputs, outputs=outputs, dt=dt)
    slow = ", for each platform the first time for minutes" if requested else ", for some seconds"
    with _staged(target.parent) as scratch, reported(f"Compiling {target.name} from C{slow}."):
        model = model_of(program, write_c(program), timing, description, stop_time)
        try:
            build_fmu(model, scratch, fmi=fmi, platforms=requested).replace(target)
        except RuntimeError as error:  # no compiler, a failing one, or an unknown platform
            raise FMUError(f"{target} cannot be built: {error}") from error
    if timing is None and (late := late_outputs(program)):
        tell(late)
    return target


def export_c(
    exported: Block | Diagram,
    folder: str | PathLike[str],
    *,
    name: str | None = None,
    blocks: Sequence[str] | str | None = None,
    inputs: Names | None = None,
    outputs: Names | None = None,
    dt: float | str | Fraction | None = None,
) -> tuple[Path, Path]:
    """Write a block, or some blocks of a diagram, as C99 that needs nothing but the mathematics of the C library.

    Call ``<name>_init`` once and ``<name>_step`` at each step: it computes the outputs from the inputs of the same time. The
    header explains more. Nothing is allocated; all memory is in one structure of fixed size.

    Parameters
    ----------
    exported : Block or Diagram
        The block, or the diagram with the blocks, to export.
    folder : str or path
        The folder for ``<name>.c`` and ``<name>.h``, created if it does not exist; existing files of these names are replaced.
    name : str, optional
        Prefix of types and functions and name of both files, spelt as C allows it; by default the block's name.
    blocks : sequence of str, optional
        Names of the blocks of a diagram that become one step; by default all. An FMU cannot be among them.
    inputs, outputs : sequence of str or mapping of str to str, optional
        The inputs and outputs of the program, as of `export_fmu`.
    dt : float, str or Fraction, optional
        The sample time, for a block that does not define one.

    Returns
    -------
    tuple of pathlib.Path
        The C file and its header.

    Raises
    ------
    KernelError
        If a step function cannot be translated to C; the message names the line.
    ModelError
        If a block is an FMU or calls Python, or the settings are not valid.
    ResultFileError
        If the files cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from bayesftc import cosim
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = cosim.export_c(cosim.Saturation(-1.0, 1.0), folder, name="limit", dt=0.01)
    ...     print([file.name for file in files])
    ['limit.c', 'limit.h']
    """
    target = c_folder(folder)
    program = program_of(exported, name=name, blocks=blocks, inputs=inputs, outputs=outputs, dt=dt)
    written = write_c(replace(program, name=program_name(program.name)))
    files = {f"{written.name}.c": written.source, f"{written.name}.h": written.header}
    with _staged(target) as scratch:
        for file, text in files.items():
            (scratch / file).write_text(text, encoding="utf-8", newline="\n")
        for file in files:
            (scratch / file).replace(target / file)
    source, header = (target / file for file in files)
    return source, header


def c_folder(folder: str | PathLike[str]) -> Path:
    """Return the folder for C, which exists or can be made in one that exists.

    Raises
    ------
    ResultFileError
        If it cannot be made.
    """
    target = expanded(folder)
    if target.suffix.lower() in {".c", ".h", ".fmu"} and not target.is_dir():
        raise ResultFileError(
            f"{target} is the name of a file, but C is written into a folder, as <name>.c and <name>.h. Give a folder, such as "
            f"{target.stem}."
        )
    _folder(target if target.exists() else target.parent)
    return target


def fmu_file(path: str | PathLike[str]) -> Path:
    """Return the FMU's path, in an existing folder.

    Raises
    ------
    ResultFileError
        If it has no such path.
    """
    target = expanded(path)
    if target.suffix.lower() != ".fmu":
        example = "controller.fmu, say" if target.stem in ("", ".fmu") else f"{target.stem}.fmu"
        raise ResultFileError(f"{path} does not end in .fmu, which other tools need; name it {example}.")
    if len(os.fsencode(target.name)) > _LONGEST:
        raise ResultFileError(
            f"The name {brief(target.name)} is too long for a file; use one of at most {_LONGEST} bytes."
        )
    if target.is_dir():
        raise ResultFileError(f"{target} is a folder; give the FMU another name.")
    return _folder(target.parent) / target.name


def _folder(folder: str | PathLike[str]) -> Path:
    target = expanded(folder)
    if not target.is_dir():
        what = "does not exist; create the folder, or choose another"
        if target.exists():
            what = "is a file and no folder; choose another name"
        raise ResultFileError(f"Nothing can be written into {target}: it {what}.")
    return target


@contextmanager
def _staged(folder: Path) -> Iterator[Path]:
    """Provide a temporary folder beside the target, so that each file appears under its name only when it is complete."""
    try:
        folder.mkdir(exist_ok=True)
        with temporary_folder(BESIDE, folder) as scratch:
            yield scratch
    except OSError as error:
        raise ResultFileError(
            f"Nothing can be written into {folder}: {error.strerror or error}; choose another folder."
        ) from None
