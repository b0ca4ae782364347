"""The specification of a model, from which the model description and the C header of an FMU are written."""

import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, product
from pathlib import Path
from typing import Literal

__all__ = ["Model", "Unit", "Variable"]

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z_][A-Za-z0-9_]*|\[[0-9]+(,[0-9]+)*\])*")
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
# The variabilities of each causality; the first is the default.
_VARIABILITY = {
    "input": ("continuous", "discrete"),
    "output": ("continuous", "discrete"),
    "local": ("continuous", "discrete"),
    "parameter": ("fixed", "tunable"),
}


@dataclass(frozen=True)
class Unit:
    """A unit and its exponents of the SI base units.

    Parameters
    ----------
    name : str
        Name in the model description, for example ``"N.s/m"``.
    kg, m, s, A, K, mol, cd, rad : int
        Exponents of the base units.
    factor, offset : float
        A value ``x`` in this unit is ``factor * x + offset`` in SI.
    defined : bool
        Whether exponents, factor and offset are known; otherwise the model description contains only the name.
    """

    name: str
    kg: int = 0
    m: int = 0
    s: int = 0
    A: int = 0
    K: int = 0
    mol: int = 0
    cd: int = 0
    rad: int = 0
    factor: float = 1.0
    offset: float = 0.0
    defined: bool = True


@dataclass(frozen=True)
class Variable:
    """One variable of a model, a number or an array of numbers.

    Parameters
    ----------
    name : str
        Name in the model description, for example ``"force"`` or ``"y[1]"``.
    causality : {"input", "output", "parameter", "local"}
        Inputs and parameters are set by the importer, outputs and locals by the model.
    description : str
        One sentence for the user of the FMU.
    unit : Unit, optional
        None for a number without a unit.
    start : float or tuple of float
        Value before initialization; for an output or a local variable, its value until the model computes it. For an array it is
        one value for all elements, or one value for each, row by row.
    variability : {"continuous", "discrete", "fixed", "tunable"}, optional
        By default, inputs, outputs and locals are continuous, and parameters are fixed.
    dependencies : tuple of str
        For an output: the inputs with direct feedthrough to it. Empty means no direct feedthrough; it is written to the model
        description, because importers would otherwise assume algebraic loops.
    initial_dependencies : tuple of str
        For an output: the inputs and parameters from which its initial value is computed.
    shape : tuple of int
        ``()`` for a number. An array is one variable in FMI 3, and one for each element in FMI 2, ``y[0]`` the first.
    element_dependencies : tuple of tuple of str
        For an output, in place of `initial_dependencies`: for each of its elements, the elements of inputs and parameters from
        which its initial value is computed.
    origin : str
        For an exported block: the variable's name in the diagram, if it is different. Written as a vendor annotation.
    element_descriptions : tuple of str
        In place of `description` where each element is one variable, as in FMI 2.
    element_units : tuple of (Unit or None)
        In place of `unit` there.
    """

    name: str
    causality: Literal["input", "output", "parameter", "local"]
    description: str
    unit: Unit | None = None
    start: float | tuple[float, ...] = 0.0
    variability: Literal["", "continuous", "discrete", "fixed", "tunable"] = ""
    dependencies: tuple[str, ...] = ()
    initial_dependencies: tuple[str, ...] = ()
    shape: tuple[int, ...] = ()
    element_dependencies: tuple[tuple[str, ...], ...] = ()
    origin: str = ""
    element_descriptions: tuple[str, ...] = ()
    element_units: tuple[Unit | None, ...] = ()

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise ValueError(f"The variable name {self.name!r} is not valid in FMI. Use letters, digits, '.', '[1]'.")
        if len(self.starts) != self.size:
            raise ValueError(f"'{self.name}' has {self.size} elements, but {len(self.starts)} start values.")
        if not all(map(math.isfinite, self.starts)):
            raise ValueError(
                f"The start value {self.start} of '{self.name}' is not finite, which FMI does not support."
            )
        allowed = _VARIABILITY[self.causality]
        if not self.variability:
            object.__setattr__(self, "variability", allowed[0])
        elif self.variability not in allowed:
            raise ValueError(
                f"'{self.name}' is {self.causality} and cannot be {self.variability}. Use one of {', '.join(allowed)}."
            )
        if self.causality != "output" and (self.dependencies or self.initial_dependencies):
            raise ValueError(f"'{self.name}' is {self.causality}, but only an output has dependencies.")

    @property
    def size(self) -> int:
        """Number of elements."""
        return math.prod(self.shape)

    @property
    def starts(self) -> tuple[float, ...]:
        """The start value of each element."""
        return self.start if isinstance(self.start, tuple) else (self.start,) * self.size

    @property
    def elements(self) -> tuple[str, ...]:
        """The name of each element; for a number, its own name."""
        indices = product(*map(range, self.shape))
        return tuple(self.name + (f"[{','.join(map(str, index))}]" if index else "") for index in indices)

    @property
    def described(self) -> tuple[str, ...]:
        """The description of each element."""
        return self.element_descriptions or (self.description,) * self.size

    @property
    def calculated(self) -> bool:
        """Whether the model computes it, so it has no start value."""
        return self.causality in {"output", "local"}

    @property
    def symbol(self) -> str:
        """The C name of its index in the vector of values."""
        return "X_" + re.sub(r"[^A-Za-z0-9_]", "_", self.name)


@dataclass(frozen=True)
class Model:
    """A model: its variables, and the C file with the functions of ``c/model.h``.

    Parameters
    ----------
    name : str
        Model name, model identifier, and stem of the FMU's file.
    description : str
        One or two sentences for the user of the FMU.
    source : pathlib.Path or mapping of str to str
        C file that defines ``model_initialize`` and ``model_step``; or the texts of several C files and headers by name.
    variables : tuple of Variable
        In the order of their elements in the vector of values.
    step : float
        Preferred communication step size [s].
    fixed_step : bool
        Whether the model accepts only that step size.
    stop_time : float
        Stop time of the default experiment [s].
    hidden : int
        Number of doubles of state or scratch space that are no variables.
    timing : {"plant", "sampled"}
        Whether the outputs at t_k are those before the step from t_k ("plant"), or the result of a step with the inputs at t_k
        ("sampled", as for a controller). Written as a vendor annotation.
    libraries : tuple of str
        System libraries that the C file needs, for example ``("m",)``.
    blocks : tuple of str
        Names of the exported blocks of a diagram. Written as a vendor annotation.
    traits : str
        What an exported controller says about itself beside its variables, as JSON. Written as a vendor annotation.
    finite : bool
        Whether a NaN in the outputs is an error, as for a plant, and not a missing sample. If not, this is written as a vendor
        annotation.
    """

    name: str
    description: str
    source: Path | Mapping[str, str]
    variables: tuple[Variable, ...]
    step: float
    fixed_step: bool = False
    stop_time: float = 20.0
    hidden: int = 0
    timing: Literal["plant", "sampled"] = "plant"
    libraries: tuple[str, ...] = ()
    blocks: tuple[str, ...] = ()
    traits: str = ""
    finite: bool = True

    def __post_init__(self) -> None:
        if not _IDENTIFIER.fullmatch(self.name):
            raise ValueError(f"The model name {self.name!r} is no C identifier. Use letters, digits and '_'.")
        if not (math.isfinite(self.step) and self.step > 0.0):
            raise ValueError(f"The step size {self.step} of '{self.name}' must be positive and finite.")
        symbols = Counter([*(variable.symbol for variable in self.variables), "X_time", "X_TIME", "X_HIDDEN"])
        for variable in self.variables:
            if symbols[variable.symbol] > 1:
                raise ValueError(
                    f"The variable '{variable.name}' of '{self.name}' has the C name {variable.symbol}, like another variable "
                    "or the time. Rename it."
                )
        sources = {v.name for v in self.variables if v.causality in {"input", "parameter"}}
        for variable in self.variables:
            for name in variable.dependencies + variable.initial_dependencies:
                if name not in sources:
                    raise ValueError(
                        f"The output '{variable.name}' of '{self.name}' depends on '{name}', which is neither an input "
                        "nor a parameter."
                    )

    @property
    def outputs(self) -> tuple[Variable, ...]:
        """The outputs, in order."""
        return tuple(variable for variable in self.variables if variable.causality == "output")

    @property
    def units(self) -> tuple[Unit, ...]:
        """The units, each once, in order of appearance, with seconds first for the time."""
        used = [Unit("s", s=1)] + [variable.unit for variable in self.variables if variable.unit is not None]
        return tuple(dict.fromkeys(used))

    def index(self, name: str) -> int:
        """Index of a variable, which is its value reference."""
        return self._places[name][0]

    def offset(self, name: str) -> int:
        """Index of a variable's first element in the vector of values."""
        return self._places[name][1]

    @cached_property
    def _places(self) -> dict[str, tuple[int, int]]:
        offsets = accumulate((variable.size for variable in self.variables), initial=0)
        return {v.name: (i, offset) for i, (v, offset) in enumerate(zip(self.variables, offsets, strict=False))}

    @property
    def size(self) -> int:
        """Total number of elements of all variables."""
        return sum(variable.size for variable in self.variables)

    def flat(self) -> "Model":
        """Return the model with each element of an array as a separate variable, as in FMI 2."""
        elements = {variable.name: variable.elements for variable in self.variables}

        def each(names: tuple[str, ...]) -> tuple[str, ...]:
            return tuple(element for name in names for element in elements[name])

        def of_elements(variable: Variable) -> tuple[tuple[str, ...], ...]:
            return variable.element_dependencies or (each(variable.initial_dependencies),) * variable.size

        return replace(
            self,
            variables=tuple(
                replace(
                    variable,
                    name=name,
                    description=description,
                    element_descriptions=(),
                    unit=unit,
                    element_units=(),
                    start=start,
                    shape=(),
                    dependencies=each(variable.dependencies),
                    initial_dependencies=exact,
                    element_dependencies=(),
                    origin=variable.origin and variable.origin + name.removeprefix(variable.name),
                )
                for variable in self.variables
                for name, start, exact, description, unit in zip(
                    variable.elements,
                    variable.starts,
                    of_elements(variable),
                    variable.described,
                    variable.element_units or (variable.unit,) * variable.size,
                    strict=True,
                )
            ),
        )
