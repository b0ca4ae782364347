"""FMUs from other tools: each function writes one into a folder, or finds one in a package, and returns its path.

If a tool is not installed, the functions raise `MissingTool`, whose message has the command to install it.
"""

import importlib.util
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

TANKS = '''
from math import sqrt
from pythonfmu import DefaultExperiment, Fmi2Causality, Fmi2Slave, Real

class Tanks(Fmi2Slave):
    """Two tanks, one below the other; a pump (m3/s) fills the upper one."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.default_experiment = DefaultExperiment(step_size=0.5)
        self.upper, self.level, self.pump, self.leak = 0.1, 0.1, 0.0014, 0.0
        for name in ("pump", "leak"):
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        self.register_variable(Real("level", causality=Fmi2Causality.output))

    def do_step(self, now, step):
        for _ in range(20):
            down = 0.001 * sqrt(2 * 9.81 * max(self.upper, 0.0))
            out = 0.001 * sqrt(2 * 9.81 * max(self.level, 0.0))
            self.upper += step / 20 * (self.pump - down) / 0.01
            self.level += step / 20 * (down - out - self.leak) / 0.01
        return True
'''

ROOM = '''
from pythonfmu3 import DefaultExperiment, Float64, Fmi3Causality, Fmi3Slave, Fmi3Variability

class Room(Fmi3Slave):
    """A room and its walls; a heater (kW) warms the air, and the outside cools the walls."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.default_experiment = DefaultExperiment(step_size=60.0)
        self.time, self.air, self.walls, self.heater, self.outside = 0.0, 15.0, 10.0, 1.0, 5.0
        self.register_variable(
            Float64("time", causality=Fmi3Causality.independent, variability=Fmi3Variability.continuous)
        )
        for name in ("heater", "outside"):
            self.register_variable(Float64(name, causality=Fmi3Causality.input, start=getattr(self, name)))
        self.register_variable(Float64("air", causality=Fmi3Causality.output))

    def do_step(self, now, step):
        for _ in range(20):
            through = 0.2 * (self.air - self.walls)  # kW
            self.air += step / 20 * (self.heater - through) / 150.0  # kJ/K
            self.walls += step / 20 * (through - 0.2 * (self.walls - self.outside)) / 3000.0
        return True
'''


class MissingTool(Exception):
    """The tool for an FMU is not installed."""


def tanks(folder: Path) -> Path:
    """Return two tanks exported by PythonFMU: FMI 2, co-simulation."""
    return _of_python("pythonfmu", "tanks", TANKS, folder)


def room(folder: Path) -> Path:
    """Return a heated room exported by PythonFMU3: FMI 3, co-simulation."""
    return _of_python("pythonfmu3", "room", ROOM, folder)


def pendulum(folder: Path) -> Path:
    """Return a pendulum with a torque exported by CasADi: FMI 2, model exchange, only C sources."""
    _need("casadi", "casadi")
    import casadi as ca

    dae = ca.DaeBuilder("pendulum")
    angle, speed, torque, y = dae.add("angle"), dae.add("speed"), dae.add("torque", "input"), dae.add("y", "output")
    for name, rate in (("angle", speed), ("speed", -9.81 * ca.sin(angle) - 0.1 * speed + torque)):
        dae.eq(dae.der(dae.var(name)), rate)
    dae.eq(y, angle)
    here = Path.cwd()
    os.chdir(folder)  # CasADi writes into the current folder
    try:
        written = dae.export_fmu({"no_warning": True})
    finally:
        os.chdir(here)
    with zipfile.ZipFile(folder / "pendulum.fmu", "w") as archive:
        for name, place in written.items():
            archive.write(folder / name, place.removeprefix("./"))
    return folder / "pendulum.fmu"


def mass(folder: Path) -> Path:
    """Return a mass on a spring and a damper exported by OpenModelica: FMI 2, from the package gemseo-fmu."""
    package = _need("gemseo_fmu", "--no-deps gemseo-fmu")
    return package / "problems" / "fmu_files" / "linux" / "Mass_Damper.fmu"


def motor(folder: Path) -> Path:
    """Return a motor (position, speed, current; input voltage) made from matrices by qfmu: FMI 2, needs gcc."""
    package = _need("qfmu", "--no-deps qfmu")
    matrices = {
        "-A": "[[0,1,0],[0,-2,10],[0,-1,-20]]",
        "-B": "[[0],[0],[20]]",
        "-C": "[[1,0,0]]",
        "-x0": "[0.0,0.0,0.0]",
    }
    options = [part for pair in matrices.items() for part in pair]
    command = [sys.executable, "-m", "qfmu", "ss", *options, "-o", str(folder / "motor.fmu")]
    path = os.pathsep.join([str(package.parent), os.environ.get("PYTHONPATH", "")])
    subprocess.run(command, check=True, capture_output=True, env={**os.environ, "PYTHONPATH": path})
    return folder / "motor.fmu"


MAKERS: dict[str, Callable[[Path], Path]] = {
    "PythonFMU": tanks,
    "PythonFMU3": room,
    "CasADi": pendulum,
    "OpenModelica": mass,
    "qfmu": motor,
}
"""The function for each tool."""


def _of_python(tool: str, name: str, source: str, folder: Path) -> Path:
    _need(tool, tool)
    builder = importlib.import_module(f"{tool}.builder")
    file = folder / f"{name}.py"
    file.write_text(source)
    return Path(builder.FmuBuilder.build_FMU(file, dest=folder))


def _need(module: str, install: str) -> Path:
    """Return a package's folder, without importing it."""
    spec = importlib.util.find_spec(module)
    if spec is None or spec.origin is None:
        raise MissingTool(f"{module} is not installed. Install it with: python -m pip install {install}")
    return Path(spec.origin).parent
