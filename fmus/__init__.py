"""The plants that are shipped as FMUs, and what builds them.

``path("CruiseControl")`` finds a shipped FMU and ``names()`` lists them; neither needs a compiler.
``python -m bayesftc.fmus build`` builds them anew. :mod:`bayesftc.fmus.spec` describes a model, and
:mod:`bayesftc.fmus.build` makes an FMU of it and of a C file that keeps the contract of ``c/model.h``.
"""

from bayesftc.fmus._catalogue import names, path

__all__ = ["names", "path"]
