"""Names that FMI and C both allow, each once."""

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
"""What FMI 3 calls the time, which is a variable there, and the wrapper's C its own."""


def legal(name: str) -> str:
    """Return a name with what FMI does not allow spelt otherwise: ``größe-1.y`` becomes ``groesse_1.y``."""
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
    """Refuse a name that was given and that FMI does not allow."""
    if not isinstance(name, str) or not _LEGAL.fullmatch(name):
        raise ModelError(
            f"The {what} of what is exported cannot be called {brief(name)}; FMI allows letters from a to z, digits and '_', "
            "parts after a '.', and an index such as '[1]', and no digit to begin with."
        )


_HEADERS = (
    "assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic stdbool "
    "stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype "
    "fmi2 fmi3 instance model model_config runge_kutta"
)
"""Files of the C library and of an FMU's own sources, in whose place one of the same name would be found."""

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
"""What the C itself, the C library and POSIX call so, and a type cannot be called, too."""

_FILES, _CLASHING = frozenset(_HEADERS.split()), frozenset(_LIBRARY.split())


def program_name(name: str) -> str:
    """Return what files, types and functions begin with: a name as C, the C library and the FMI wrappers allow it.

    ``Größe 1`` becomes ``Groesse_1``, ``2fast`` becomes ``block_2fast``, and ``model`` ``model_``.
    """
    plain = Functions.allowed(_plain(name).replace(".", "_").lstrip("_"))  # C keeps names with a _ first for itself
    if not plain[:1].isalpha():
        plain = f"block_{plain}".rstrip("_")
    taken = plain in _CLASHING or plain.lower() in _FILES or len(plain) == 1
    return f"{plain}_" if taken or re.match(r"X_|MODEL_|fmi[23][A-Z]|Instance$", plain) else plain


def in_c(name: str) -> str:
    """Return what a signal or a parameter is called in its structure."""
    return Functions.allowed(name.replace("]", "").replace("[", "_").replace(",", "_").replace(".", "_"))


def unique(wanted: Iterable[tuple[str, tuple[int, ...]]]) -> list[str]:
    """Return legal names for signals of these names and shapes, no two of them the same to FMI, to C, or to the wrapper's C.

    The first keeps its name; a number is added to a later one.
    """
    seen = set(_TAKEN)
    found = []
    for name, shape in wanted:
        plain, count = legal(name), 1
        candidate = plain
        while not seen.isdisjoint(_spellings(candidate, shape)):
            count += 1
            candidate = _numbered(plain, count)
        seen |= _spellings(candidate, shape)
        found.append(candidate)
    return found


def _spellings(name: str, shape: tuple[int, ...]) -> set[str]:
    symbols = (re.sub(r"\W", "_", label, flags=re.ASCII) for label in labels(name, shape))
    return {in_c(name), re.sub(r"\W", "_", name, flags=re.ASCII), *symbols}


def _numbered(name: str, count: int) -> str:
    stem, index, rest = name.partition("[")
    return f"{stem}_{count}{index}{rest}"
