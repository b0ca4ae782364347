"""Takes blocks away from Python: as an FMU that runs in any other tool, or as C for firmware."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import Literal

from bayesftc.cosim.base.paths import expanded
from bayesftc.cosim.base.temporary import BESIDE, temporary_folder
from bayesftc.cosim.block import Block
from bayesftc.cosim.diagram.diagram import Diagram
from bayesftc.cosim.diagram.opening import Names
from bayesftc.cosim.errors import FMUError, ModelError, ResultFileError, brief
from bayesftc.cosim.export.c_file import write_c
from bayesftc.cosim.export.fmu import model_of
from bayesftc.cosim.export.names import program_name
from bayesftc.cosim.export.platforms import platforms_of
from bayesftc.cosim.export.program import program_of

_LONGEST = 200
"""Bytes of an FMU's file name: others, a little longer, are made of it."""


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
        The file to write; its stem becomes the model's name, spelt as C allows it (``Regler 1.fmu``: ``Regler_1``). What was
        there is replaced when all is done.
    fmi : {"2.0", "3.0"}
        Version of the standard. Vectors are arrays in FMI 3, and one variable for each element in FMI 2: ``y[0]``, ``y[1]``.
    platforms : sequence of str, optional
        For which the FMU gets binaries, besides its C sources: ``"linux-x86_64"``, ``"linux-aarch64"``, ``"windows-x86_64"``,
        ``"macos-x86_64"``, ``"macos-aarch64"``, or ``"all"``. What is named is compiled by ``ziglang``
        (``pip install 'bayesftc[export]'``) for old systems (glibc 2.17, macOS 11), to the same bytes on any machine; what it
        needs for a platform it makes at the first time, which takes minutes. By default this machine's, by its own C compiler
        where there is one.
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

    target = _file(path)
    if fmi not in FMI_VERSIONS:
        raise ModelError(f"export_fmu has fmi={fmi!r}; it must be one of {', '.join(map(repr, FMI_VERSIONS))}.")
    if timing not in (None, "plant", "sampled"):
        raise ModelError(f"export_fmu has timing={timing!r}; it must be 'plant' or 'sampled'.")
    if not isinstance(description, str) or not all(letter.isprintable() or letter.isspace() for letter in description):
        raise ModelError(
            f"export_fmu has description={brief(description)}; it must be a text without control characters."
        )
    wanted = platforms_of(platforms)
    program = program_of(exported, name=program_name(target.stem), blocks=blocks, inputs=inputs, outputs=outputs, dt=dt)
    with _staged(target.parent) as scratch:
        model = model_of(program, write_c(program), timing, description)
        try:
            build_fmu(model, scratch, fmi=fmi, platforms=wanted).replace(target)
        except RuntimeError as error:  # no compiler, one that fails, or no platform that is known
            raise FMUError(f"{target} cannot be built: {error}") from error
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

    ``<name>_init`` is called once, ``<name>_step`` at each step, from the inputs at that time to the outputs at that time; the
    header says more. Nothing is allocated; all that is remembered lies in one structure of known size.

    Parameters
    ----------
    exported : Block or Diagram
        What to export.
    folder : str or path
        Where ``<name>.c`` and ``<name>.h`` are written, made if it is not there; what was there under these names is replaced.
    name : str, optional
        What types and functions begin with, and both files are called, spelt as C allows it; by default the block's name.
    blocks : sequence of str, optional
        Names of the blocks of a diagram that become one step; by default all. An FMU cannot be among them.
    inputs, outputs : sequence of str or mapping of str to str, optional
        The signals that the outside sees, as of `export_fmu`.
    dt : float, str or Fraction, optional
        The sample time of a block that has none of its own.

    Returns
    -------
    tuple of pathlib.Path
        The C file and its header.

    Raises
    ------
    KernelError
        If a step function cannot become C; the sentence names the line.
    ModelError
        If something in it is an FMU or calls back into Python, or the settings do not fit.
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
    target = expanded(folder)
    if target.suffix.lower() in {".c", ".h", ".fmu"} and not target.is_dir():
        raise ResultFileError(
            f"C is written into a folder, as <name>.c and <name>.h, and {target} is called as a file; give a folder, such as "
            f"{target.stem}."
        )
    _folder(target if target.exists() else target.parent)
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


def _file(path: str | PathLike[str]) -> Path:
    """Return the FMU's path, in a folder that is there."""
    target = expanded(path)
    if target.suffix.lower() != ".fmu":
        named = "controller.fmu, say" if target.stem in ("", ".fmu") else f"{target.stem}.fmu"
        raise ResultFileError(f"{path} does not end in .fmu, by which other tools know an FMU; call it {named}.")
    if len(os.fsencode(target.name)) > _LONGEST:
        raise ResultFileError(
            f"The name {brief(target.name)} is too long for a file; take one of at most {_LONGEST} bytes."
        )
    if target.is_dir():
        raise ResultFileError(f"{target} is a folder; give the FMU another name.")
    return _folder(target.parent) / target.name


def _folder(folder: str | PathLike[str]) -> Path:
    target = expanded(folder)
    if not target.is_dir():
        what = "does not exist; make the folder, or choose another"
        if target.exists():
            what = "is no folder, but a file; choose another name"
        raise ResultFileError(f"Nothing can be written into {target}: it {what}.")
    return target


@contextmanager
def _staged(folder: Path) -> Iterator[Path]:
    """Give a folder beside the files to be, so that each appears under its name only when it is whole."""
    try:
        folder.mkdir(exist_ok=True)
        with temporary_folder(BESIDE, folder) as scratch:
            yield scratch
    except OSError as error:
        raise ResultFileError(
            f"Nothing can be written into {folder}: {error.strerror or error}; choose another folder."
        ) from None
