"""Unique names that both FMI and C allow."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable

from bayesftc.cosim.errors import ModelError, brief
from bayesftc.cosim.ports import labels
from bayesftc.cosim.stepping.translate.functions import Functions

_LEGAL = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z_][A-Za-z0-9_]*|\[[0-9]+(,[0-9]+)*\])*")
_INDEX = re.compile(r"(\[[0-9]+(?:,[0-9]+)*\])")
_LETTERS = {
    "ä": "ae",
    "ö": "oe",
    "ü": "ue",
    "Ä": "Ae",
    "Ö": "Oe",
    "Ü": "Ue",
    "ß": "ss",
    "ø": "oe",
    "æ": "ae",
    "å": "aa",
}
_GREEK = re.compile(r"GREEK (?:SMALL|CAPITAL) LETTER (\w+)$")

_TAKEN = frozenset({"time", "TIME", "HIDDEN"})
"""Names that FMI 3 (for the time, which is a variable there) and the wrapper's C use."""


def legal(name: str) -> str:
    """Return a name with characters that FMI does not allow replaced: ``größe-1.y`` becomes ``groesse_1.y``."""
    if _LEGAL.fullmatch(name):
        return name
    pieces = _INDEX.split(name)
    return "".join(
        piece if i % 2 else ".".join(map(_plain, piece.split("."))) for i, piece in enumerate(pieces) if piece
    )


def _plain(name: str) -> str:
    spelt = "".join(_LETTERS.get(c) or _spelt(c) for c in unicodedata.normalize("NFC", name))
    plain = re.sub(r"\W+", "_", spelt, flags=re.ASCII)
    return plain if re.match(r"[A-Za-z_]", plain) else f"_{plain}"


def _spelt(letter: str) -> str:
    if letter.isascii():
        return letter
    greek = _GREEK.match(unicodedata.name(letter, ""))
    if greek:
        return greek[1].lower()
    return unicodedata.normalize("NFKD", letter).encode("ascii", "ignore").decode() or "_"


def check(name: str, what: str) -> None:
    """Refuse a user's name that FMI does not allow."""
    if not isinstance(name, str) or not _LEGAL.fullmatch(name):
        raise ModelError(
            f"An {what} of the export cannot be named {brief(name)}. FMI allows letters from a to z, digits (not at the "
            "beginning) and '_', parts after a '.', and an index such as '[1]'."
        )


_HEADERS = (
    "assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic stdbool "
    "stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype "
    "fmi2 fmi3 instance model model_config runge_kutta"
)
"""Files of the C library and of an FMU's sources, which a file of the same name would hide."""

_LIBRARY = (
    "PROGRAM INPUTS OUTPUTS program begin tune initial model_initialize model_step "
    "abort abs atexit atof atoi atol atoll bsearch calloc div exit free getenv labs ldiv llabs lldiv malloc qsort rand realloc "
    "srand strtod strtof strtol strtold strtoll strtoul strtoull system clearerr fclose feof ferror fflush fgetc fgetpos fgets "
    "fopen fprintf fputc fputs fread freopen fscanf fseek fsetpos ftell fwrite getc getchar gets perror printf putc putchar "
    "puts remove rename rewind scanf setbuf setvbuf snprintf sprintf sscanf stderr stdin stdout tmpfile tmpnam ungetc vfprintf "
    "vprintf vsnprintf vsprintf memchr memcmp memcpy memmove strcat strchr strcmp strcoll strcpy strcspn strerror strlen "
    "strncat strncmp strncpy strpbrk strrchr strspn strstr strtok strxfrm asctime clock ctime difftime gmtime localtime mktime "
    "strftime raise close link open pause pipe read select sleep sync wait write index"
)
"""Names in the generated C, the C library and POSIX, which a type cannot have."""

_FILES, _CLASHING = frozenset(_HEADERS.split()), frozenset(_LIBRARY.split())


def program_name(name: str) -> str:
    """Return the prefix of files, types and functions: a name that C, the C library and the FMI wrappers allow.

    ``Größe 1`` becomes ``Groesse_1``, ``2fast`` becomes ``block_2fast``, and ``model`` ``model_``.
    """
    plain = Functions.allowed(_plain(name).replace(".", "_").lstrip("_"))  # C reserves names with a leading _
    if not plain[:1].isalpha():
        plain = f"block_{plain}".rstrip("_")
    taken = plain in _CLASHING or plain.lower() in _FILES or len(plain) == 1
    return f"{plain}_" if taken or re.match(r"X_|MODEL_|fmi[23][A-Z]|Instance$", plain) else plain


def in_c(name: str) -> str:
    """Return the name of a signal or a parameter in its structure."""
    return Functions.allowed(name.replace("]", "").replace("[", "_").replace(",", "_").replace(".", "_"))


def unique(signals: Iterable[tuple[str, tuple[int, ...]]]) -> list[str]:
    """Return legal names for signals of these names and shapes, all different in FMI, in C, and in the wrapper's C.

    The first of equal names stays; the others get a number.
    """
    seen = set(_TAKEN)
    result = []
    for name, shape in signals:
        plain, count = legal(name), 1
        candidate = plain
        while not seen.isdisjoint(_spellings(candidate, shape)):
            count += 1
            candidate = _numbered(plain, count)
        seen |= _spellings(candidate, shape)
        result.append(candidate)
    return result


def _spellings(name: str, shape: tuple[int, ...]) -> set[str]:
    symbols = (re.sub(r"\W", "_", label, flags=re.ASCII) for label in labels(name, shape))
    return {in_c(name), re.sub(r"\W", "_", name, flags=re.ASCII), *symbols}


def _numbered(name: str, count: int) -> str:
    stem, index, rest = name.partition("[")
    return f"{stem}_{count}{index}{rest}"
