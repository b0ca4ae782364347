"""From step functions to C, and from there to FMUs and firmware.

What is exported: ``program`` (with ``signals``, ``names``, ``units``, ``tunables``). Its C: ``c_file``, of ``layout`` and
``functions``, each of which a ``translator`` writes, on top of ``context``, ``arithmetic``, ``conditions`` and ``expressions``,
with what these know in ``source``, ``kinds`` and ``values``. Its description as an FMU: ``fmu``, with ``dependencies`` (by
``sets``) and ``platforms``. Whether an FMU does the same: ``stand_in`` and ``deviations``.
"""
