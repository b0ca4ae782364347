"""Write `fmus/c/elementary.h`: sine and cosine in C for the shipped plants, translated from `cosim/elementary.py`.

    python tools/elementary.py

FMUs are below step functions and their translator, so this text is kept as a file. Run it after a change of the functions, and
then `python -m bayesftc.fmus build`.
"""

from __future__ import annotations

from pathlib import Path

from bayesftc.cosim.elementary import cosine, sine
from bayesftc.cosim.export.c_file import CAREFUL
from bayesftc.cosim.stepping.translate.functions import Functions
from bayesftc.cosim.stepping.translate.kinds import FLOAT

HEADER = Path(__file__).resolve().parents[1] / "fmus" / "c" / "elementary.h"
_BEGIN = """\
/* Sine and cosine as one fixed sequence of operations: the same bits with every compiler and C library.
 *
 * Written by tools/elementary.py, which translates cosim/elementary.py of bayesftc; do not edit.
 */
#ifndef BAYESFTC_ELEMENTARY_H
#define BAYESFTC_ELEMENTARY_H

#include <math.h>
#include <stdint.h>
"""


def header() -> str:
    """Return the text of the header."""
    functions = Functions()
    names = [functions.require(function, [FLOAT]).name for function in (sine, cosine)]
    return "\n".join([_BEGIN, CAREFUL, "", functions.text(names), "", "#endif", ""])


if __name__ == "__main__":
    HEADER.write_text(header(), encoding="utf-8")
