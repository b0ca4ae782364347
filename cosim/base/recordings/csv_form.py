"""How a CSV file is written: what separates its columns, and whether its numbers have decimal commas."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from os import PathLike, fspath

from bayesftc.cosim.base.announcing import inform

ENCODING, OTHER = "utf-8-sig", "cp1252"
"""UTF-8, with or without a byte order mark; and how programs on Windows wrote files in Western languages before it."""
MARKS = (b"\xff\xfe", b"\xfe\xff")
"""Marks at the begin of a file in UTF-16."""

SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}
"""What may separate columns, with its name; the first is the usual one."""

LOOKED_AT = 50
"""Rows from which the separator is found."""

_WITH_COMMA = re.compile(r"\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*")
_WITH_POINT = re.compile(r"\s*[+-]?(\d+\.\d*|\.\d+)([eE][+-]?\d+)?\s*")


@dataclass(frozen=True)
class CsvForm:
    """The separator of columns, the decimal sign and the encoding of a CSV file."""

    separator: str = ","
    decimal: str = "."
    encoding: str = ENCODING

    def number(self, text: str) -> str:
        """Return the text of a number with a decimal point."""
        return text.replace(self.decimal, ".") if self.decimal != "." and _WITH_COMMA.fullmatch(text) else text

    def has_other_sign(self, text: str) -> bool:
        """Return whether the text is a number with a decimal point in a file with decimal commas."""
        return self.decimal != "." and _WITH_POINT.fullmatch(text) is not None


def encoding_of(path: str | PathLike[str]) -> str:
    """Return the encoding of a file: UTF-8, UTF-16 with a mark at its begin, or else that of Windows for Western languages.

    Raises
    ------
    OSError, UnicodeDecodeError
        If the file cannot be read, or is no text.
    """
    with open(path, "rb") as file:
        if file.read(2) in MARKS:
            return "utf-16"
    try:
        _read_through(path, ENCODING)
    except UnicodeDecodeError:
        if _is_mostly_utf_8(path):  # with a wrong byte: as Windows-1252 its other letters would be wrong
            raise
        _read_through(path, OTHER)
        return OTHER
    return ENCODING


def _is_mostly_utf_8(path: str | PathLike[str]) -> bool:
    """Return whether a text has letters in UTF-8 of more than one byte."""
    with open(path, encoding=ENCODING, errors="replace", newline="") as text:
        while part := text.read(1 << 20):
            if not part.replace("\N{REPLACEMENT CHARACTER}", "").isascii():
                return True
    return False


def _read_through(path: str | PathLike[str], encoding: str) -> None:
    """Read a text, and refuse one with a zero, as files have that are no text."""
    with open(path, encoding=encoding, newline="") as text:
        while part := text.read(1 << 20):
            if "\0" in part:
                raise UnicodeDecodeError(encoding, b"\0", 0, 1, "a zero is no text")


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
    encoding = encoding_of(path)
    if encoding == OTHER:
        inform(f"{fspath(path)} is no text in UTF-8. It is read as Windows-1252 (Latin-1).")
    form = CsvForm(encoding=encoding)
    if _fits(path, form):
        return form
    form = next((other for mark in others if _fits(path, other := replace(form, separator=mark))), form)
    if form.separator == usual:
        return form
    form = replace(form, decimal="," if _has_decimal_commas(path, form) else ".")
    decimal = " and decimal commas" if form.decimal == "," else ""
    inform(f"{fspath(path)} is read with {SEPARATORS[form.separator]} between its columns{decimal}.")
    return form


def cells_of(path: str | PathLike[str], form: CsvForm) -> Iterator[tuple[int, list[str]]]:
    """Give the number of the line where each row ends, and its cells, without empty lines and without comments at the top.

    Comments are the first lines that begin with ``#``. The last of them is the row of names if it has as many cells as the row
    below it.
    """
    with open(path, encoding=form.encoding, newline="") as text:
        reader = csv.reader(text, delimiter=form.separator, skipinitialspace=True, strict=True)
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


def lines_above(path: str | PathLike[str], form: CsvForm) -> int:
    """Return how many lines stand above the row of names."""
    try:
        number, names = next(cells_of(path, form), (1, []))
    except csv.Error:  # the reader of the table says what is wrong
        return 0
    return number - 1 - sum(name.count("\n") for name in names)


def _fits(path: str | PathLike[str], form: CsvForm) -> bool:
    """Return whether the first rows have the same number of cells, two or more."""
    try:
        counts = {len(cells) for _, cells in islice(cells_of(path, form), LOOKED_AT)}
    except csv.Error:
        return False
    return len(counts) == 1 and counts.pop() > 1


def _has_decimal_commas(path: str | PathLike[str], form: CsvForm) -> bool:
    """Return whether the first number that is not whole has a decimal comma."""
    for _, cells in islice(cells_of(path, form), 1, None):
        for cell in cells:
            if _WITH_COMMA.fullmatch(cell):
                return True
            if _WITH_POINT.fullmatch(cell):
                return False
    return False


__all__ = ["CsvForm", "cells_of", "form_of", "lines_above"]
