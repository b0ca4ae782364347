"""The commands of an operator: their form, and what they do."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from bayesftc.console.desk.desk import Desk
from bayesftc.console.desk.engine import Engine
from bayesftc.cosim.errors import ModelError

LONGEST = 8192
"""Most bytes of a command."""

Name = Annotated[str, Field(min_length=1, max_length=200)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Whole = Annotated[int, Field(ge=-(2**53), le=2**53)]


class _Command(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class Run(_Command):
    """Continue, or pause."""

    do: Literal["run"]
    on: bool


class Step(_Command):
    """Pause, and compute some steps."""

    do: Literal["step"]
    steps: int = Field(default=1, ge=1, le=1_000_000)


class Pace(_Command):
    """Set the pace; without a number as fast as possible."""

    do: Literal["pace"]
    pace: Number | None


class Fault(_Command):
    """Add a fault of a sensor or an actuator."""

    do: Literal["fault"]
    target: Name
    settings: dict[Name, bool | Whole | Number | Annotated[str, Field(max_length=200)]] = Field(max_length=24)


class Repair(_Command):
    """End a fault."""

    do: Literal["repair"]
    name: Name


class Set(_Command):
    """Set a reference, or an input or parameter of the plant."""

    do: Literal["goal", "input"]
    target: Name
    value: Number


class Back(_Command):
    """Return to an earlier step."""

    do: Literal["back"]
    k: int = Field(ge=0, le=2**53)


class OfBranch(_Command):
    """Continue with, compare, or remove a branch."""

    do: Literal["choose", "compare", "remove"]
    name: Name | None


class Rename(_Command):
    """Give a branch another name."""

    do: Literal["rename"]
    name: Name
    new: Name


class Drop(_Command):
    """Drop the samples of a wire of a live run."""

    do: Literal["drop"]
    wire: Name
    seconds: Number


Command = Run | Step | Pace | Fault | Repair | Set | Back | OfBranch | Rename
COMMANDS: TypeAdapter[Command] = TypeAdapter(Command)
LIVE_COMMANDS: TypeAdapter[Drop] = TypeAdapter(Drop)

T = TypeVar("T")


def read_command(content: Any, among: TypeAdapter[T]) -> T:
    """Return the command of a message.

    Raises
    ------
    ModelError
        If it is none of `COMMANDS`, or of `LIVE_COMMANDS`.
    """
    try:
        return among.validate_python(content)
    except ValidationError:
        do = content.get("do") if isinstance(content, dict) else None
        raise ModelError(f"The command {str(do)[:40]!r} is not known, or has a wrong setting.") from None


def carry_out(engine: Engine, command: Command) -> Callable[[Desk], None]:
    """Return a function that does what a command says, for `Engine.call`."""

    def act(desk: Desk) -> None:
        progress = engine.progress("recomputing", desk.k)
        if isinstance(command, Run):
            if command.on:
                desk.go_on(progress)
            engine.set_running(command.on)
            desk.note("run", "run" if command.on else "pause")
        elif isinstance(command, Step):
            engine.set_running(False)
            desk.note("run", "1 step" if command.steps == 1 else f"{command.steps} steps")
            desk.advance_to(desk.k + command.steps)
        elif isinstance(command, Pace):
            engine.set_pace(inf if command.pace is None else command.pace)
            desk.note("run", "as fast as possible" if command.pace is None else f"pace {command.pace:g}")
        elif isinstance(command, Fault):
            desk.act("fault", command.target, command.settings, progress=progress)
        elif isinstance(command, Repair):
            desk.act("repair", command.name, progress=progress)
        elif isinstance(command, Set):
            desk.act(command.do, command.target, value=command.value, progress=progress)
        elif isinstance(command, Back):
            engine.set_running(False)
            desk.go_back(command.k)
        elif isinstance(command, Rename):
            desk.rename(command.name, command.new)
        elif command.do == "compare":
            desk.compare(command.name)
        elif command.name is None:
            raise ModelError(f"The command {command.do!r} needs the name of a branch.")
        elif command.do == "choose":
            desk.choose(command.name, progress)
        else:
            desk.remove(command.name)

    return act


__all__ = ["COMMANDS", "LIVE_COMMANDS", "LONGEST", "Command", "Drop", "carry_out", "read_command"]
