"""How a CSV file is written: what separates its columns, and whether its numbers have decimal commas."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from os import PathLike, fspath

from bayesftc.cosim.base.announcing import inform

ENCODING = "utf-8-sig"
"""UTF-8, with or without a byte order mark."""

SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}
"""What may separate columns, with its name; the first is the usual one."""

LOOKED_AT = 50
"""Rows from which the separator is found."""

_WITH_COMMA = re.compile(r"\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*")
_WITH_POINT = re.compile(r"\s*[+-]?(\d+\.\d*|\.\d+)([eE][+-]?\d+)?\s*")


@dataclass(frozen=True)
class CsvForm:
    """The separator of columns and the decimal sign of a CSV file."""

    separator: str = ","
    decimal: str = "."

    def number(self, text: str) -> str:
        """Return the text of a number with a decimal point."""
        return text.replace(self.decimal, ".") if self.decimal != "." and _WITH_COMMA.fullmatch(text) else text

    def has_other_sign(self, text: str) -> bool:
        """Return whether the text is a number with a decimal point in a file with decimal commas."""
        return self.decimal != "." and _WITH_POINT.fullmatch(text) is not None


def form_of(path: str | PathLike[str]) -> CsvForm:
    """Return the form of a CSV file, and inform the user once if it is not the usual one.

    Commas separate columns unless the first rows have one cell each, or different numbers of cells, with commas but the same
    number of cells, two or more, with another separator. Without commas between columns, numbers may have decimal commas.

    Raises
    ------
    OSError, UnicodeDecodeError
        If the file cannot be read.
    """
    usual, *others = SEPARATORS
    separator = usual
    if not _fits(path, usual):
        separator = next((other for other in others if _fits(path, other)), usual)
    if separator == usual:
        return CsvForm()
    form = CsvForm(separator, "," if _has_decimal_commas(path, separator) else ".")
    decimal = " and decimal commas" if form.decimal == "," else ""
    inform(f"{fspath(path)} is read with {SEPARATORS[separator]} between its columns{decimal}.")
    return form


def cells_of(path: str | PathLike[str], separator: str) -> Iterator[tuple[int, list[str]]]:
    """Give the number of the line where each row ends, and its cells, without empty lines and without comments at the top.

    Comments are the first lines that begin with ``#``. The last of them is the row of names if it has as many cells as the row
    below it.
    """
    with open(path, encoding=ENCODING, newline="") as text:
        reader = csv.reader(text, delimiter=separator, skipinitialspace=True, strict=True)
        rows = ((reader.line_num, cells) for cells in reader if any(cell.strip() for cell in cells) or len(cells) > 1)
        comment: tuple[int, list[str]] | None = None
        for number, cells in rows:
            if cells[0].startswith("#"):
                comment = number, cells
                continue
            if comment is not None and len(comment[1]) == len(cells) > 1:
                yield comment
            yield number, cells
            yield from rows


def lines_above(path: str | PathLike[str], separator: str) -> int:
    """Return how many lines stand above the row of names."""
    try:
        number, names = next(cells_of(path, separator), (1, []))
    except csv.Error:  # the reader of the table says what is wrong
        return 0
    return number - 1 - sum(name.count("\n") for name in names)


def _fits(path: str | PathLike[str], separator: str) -> bool:
    """Return whether the first rows have the same number of cells, two or more."""
    try:
        counts = {len(cells) for _, cells in islice(cells_of(path, separator), LOOKED_AT)}
    except csv.Error:
        return False
    return len(counts) == 1 and counts.pop() > 1


def _has_decimal_commas(path: str | PathLike[str], separator: str) -> bool:
    """Return whether the first number that is not whole has a decimal comma."""
    for _, cells in islice(cells_of(path, separator), 1, None):
        for cell in cells:
            if _WITH_COMMA.fullmatch(cell):
                return True
            if _WITH_POINT.fullmatch(cell):
                return False
    return False


__all__ = ["ENCODING", "CsvForm", "cells_of", "form_of", "lines_above"]
