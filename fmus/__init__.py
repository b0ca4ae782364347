"""The plants that are shipped as FMUs, and their build.

``path("CruiseControl")`` finds a shipped FMU and ``names()`` lists them; neither needs a compiler.
``python -m bayesftc.fmus build`` rebuilds them. :mod:`bayesftc.fmus.spec` describes a model, and :mod:`bayesftc.fmus.build`
makes an FMU from it and a C file with the functions of ``c/model.h``.
"""

from typing import Any

from bayesftc._public import unknown
from bayesftc.fmus._catalogue import names, path

__all__ = ["names", "path"]


def __getattr__(name: str) -> Any:
    raise unknown(name, __all__, __name__)
