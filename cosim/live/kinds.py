"""The kinds of bridges, and classes of a user's own file or module."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from bayesftc.cosim.errors import ModelError, UnknownNameError, did_you_mean
from bayesftc.cosim.live.bridge import Bridge
from bayesftc.cosim.live.files import File
from bayesftc.cosim.live.mqtt import MQTT
from bayesftc.cosim.live.opcua import OPCUA, OPCUAServer
from bayesftc.cosim.live.serial_line import Serial
from bayesftc.cosim.live.udp import UDP

BRIDGES: tuple[type[Bridge], ...] = (UDP, MQTT, OPCUA, OPCUAServer, Serial, File)
"""The kinds of bridges of this package, for ``kind = ...`` in a file of wires."""


def own_bridge(name: str, folder: Path) -> type[Bridge]:
    """Return a user's class of bridges. Its file is executed.

    Parameters
    ----------
    name : str
        ``"my_bridges.py:CanBridge"`` for a class of a file, or ``"package.module:CanBridge"`` for one of a module.
    folder : pathlib.Path
        The folder at which the path of the file begins.

    Raises
    ------
    ModelError, UnknownNameError
        If there is no such class, or it is no `Bridge`.
    """
    where, _, wanted = name.rpartition(":")
    module = _of_file(folder / where) if where.endswith(".py") else _of_name(where)
    cls = getattr(module, wanted, None)
    if cls is None:
        known = [n for n, thing in vars(module).items() if isinstance(thing, type) and issubclass(thing, Bridge)]
        raise UnknownNameError(f"{where} has no class {wanted!r}; {did_you_mean(wanted, known)}")
    if not (isinstance(cls, type) and issubclass(cls, Bridge)):
        raise ModelError(f"{name} is no bridge. Derive the class from bayesftc.cosim.live.Bridge or Reconnecting.")
    return cls


def _of_file(path: Path) -> ModuleType:
    if not path.is_file():
        raise ModelError(f"There is no file {path} with a bridge. Its path begins at the folder of the file of wires.")
    name = f"bayesftc_bridges_{path.stem}_{abs(hash(path.resolve())):x}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        raise ModelError(f"{path} cannot be executed: {type(error).__name__}: {error}. Correct the file.") from error
    return module


def _of_name(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except Exception as error:  # an own module may raise anything
        raise ModelError(
            f"The module {name!r} with a bridge cannot be imported ({error}). Install or correct it, or name a file."
        ) from error


__all__ = ["BRIDGES", "own_bridge"]
