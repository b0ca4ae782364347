"""The plants that are shipped as FMUs, and their build.

``path("CruiseControl")`` finds a shipped FMU and ``names()`` lists them; neither needs a compiler.
``python -m bayesftc.fmus build`` rebuilds them. :mod:`bayesftc.fmus.spec` describes a model, and :mod:`bayesftc.fmus.build`
makes an FMU from it and a C file with the functions of ``c/model.h``.
"""

from bayesftc.fmus._catalogue import names, path

__all__ = ["names", "path"]
