"""The table from error messages to pages in ``docs/how-to/index.md``: each message is provoked here, and has these words."""

import re
import zipfile
from dataclasses import dataclass
from pathlib import Path

import control
import numpy as np
import pytest

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim.base.extras import extra
from bayesftc.cosim.errors import BayesFTCError

PAGE = Path(__file__).resolve().parents[1] / "docs" / "how-to" / "index.md"
ROWS = re.findall(r"^\| \*(.*?)\*", PAGE.read_text(encoding="utf-8"), re.M)


def car(**settings):
    return cosim.FMU(fmus.path("CruiseControl"), **settings)


def model(**settings):
    given = {"A": [[0.999]], "B": [[2e-4]], "C": [[1], [1]], "process_covariance": 0.001, "sensor_covariance": 1.0}
    return controllers.LinearModel(**{**given, "dt": 0.02, **settings})


def two_states(A, B, C, **goal):
    return controllers.design(controllers.LinearModel(A, B, C, 1e-3, 1e-2, dt=0.1), **goal)


def loop(**parts):
    given = {"plant": car(), "controller": controllers.BayesianController(model()), "control": "force", "measured": "v"}
    return cosim.closed_loop(**{**given, "sensors": cosim.Sensors(2, 1.0), "reference": 20.0, **parts})


def connected(source, dt=0.02):
    """Return a diagram of the car whose force comes from a source."""
    diagram = cosim.Diagram(dt)
    node, plant = diagram.add(source), diagram.add(car())
    diagram.connect(node["y"], plant["force"])
    return diagram


def circle(block, **coupling):
    """Return the built diagram of two blocks that feed each other."""
    diagram = cosim.Diagram(0.1)
    one, other = diagram.add(block, "one"), diagram.add(block, "other")
    for source, target in ((one, other), (other, one)):
        diagram.connect(source[block.outputs[0].name], target[block.inputs[0].name])
    return diagram.build(**coupling)


def alone(block, duration=1.0, dt=0.02, **options):
    diagram = cosim.Diagram(dt)
    diagram.add(block)
    return diagram.simulate(duration, **options)


def changed(name, drop=(), replace=(b"", b"")):
    """Return the path of the car's FMU without some folders, or with another description."""
    with zipfile.ZipFile(fmus.path("CruiseControl")) as whole, zipfile.ZipFile(name, "w") as other:
        for entry in (e for e in whole.namelist() if not drop or not e.startswith(drop)):
            text = whole.read(entry)
            other.writestr(entry, text.replace(*replace) if entry == "modelDescription.xml" else text)
    return name


def made_by_pythonfmu(step):
    """Return the path of an FMU that executes a line of Python in its step."""
    pytest.importorskip("pythonfmu")
    from pythonfmu.builder import FmuBuilder

    Path("slave.py").write_text(
        "import os, time\nfrom pythonfmu import Fmi2Causality, Fmi2Slave, Real\n\n\nclass Slave(Fmi2Slave):\n"
        "    def __init__(self, **kwargs):\n        super().__init__(**kwargs)\n        self.x = self.u = 0.0\n"
        "        self.register_variable(Real('x', causality=Fmi2Causality.output))\n"
        "        self.register_variable(Real('u', causality=Fmi2Causality.input))\n\n"
        f"    def do_step(self, t, h):\n        {step}\n        return True\n",
        encoding="utf-8",
    )
    FmuBuilder.build_FMU("slave.py", dest=".")
    return "Slave.fmu"


def sine_of_math(u, y):
    y[0] = np.sin(u[0])


@dataclass(frozen=True)
class NotAllowed(cosim.Block):
    inputs = (cosim.Port("u", default=0.0),)
    outputs = (cosim.Port("y"),)

    def define(self, step):
        return cosim.Definition(sine_of_math)


def two_campaigns(*settings):
    pytest.importorskip("zarr")
    for each in settings:
        cosim.Campaign(loop(), duration=0.02, metrics=[cosim.Final("plant.v")], **each).run("store")


def servo():
    linear = controllers.LinearModel.from_fmu(
        fmus.path("PositionServo"), measured="angle", actuated="voltage", sensors=2
    )
    controllers.BayesianController(linear, goal_on="outputs")


def two_carts():
    A = [[0, 1, 0, 0], [-100, -0.1, 100, 0.1], [0, 0, 0, 1], [100, 0.1, -100, -0.1]]
    system = control.ss(A, [[0, 0], [1, 0], [0, 0], [0, 1]], [[0, 0, 1, 0]], 0, inputs=["u", "w"], outputs=["y"])
    controllers.design(
        system, measured="y", actuated="u", dt=0.02, sensor_std=0.01, noise={"w": 100.0}, acceptable_error=0.01
    )


def growing():
    unstable = cosim.StateSpace(control.ss([[3.0]], [[1.0]], [[1.0]], 0, 1.0), initial=[1.0])
    diagram = cosim.Diagram(1.0)
    plant, zero = diagram.add(unstable), diagram.add(cosim.Constant(0.0))
    diagram.connect(zero["y"], plant[plant.block.inputs[0].name])
    diagram.simulate(1000.0, engine="interpreted")


def limited():
    with zipfile.ZipFile(fmus.path("CruiseControl")) as archive:
        text = archive.read("modelDescription.xml")
    mass = text.index(b"<Real", text.index(b'name="m"')) + len(b"<Real")
    path = changed("limited.fmu", replace=(text, text[:mass] + b' min="1" max="1000"' + text[mass:]))
    cosim.FMU(path, parameters={"m": -1.0})


ACTUATORS = controllers.SwitchingPrecision(actuator_modes=[controllers.InputOffset()])
PROVOKED = {
    "The diagram has an algebraic loop": lambda: circle(cosim.Gain(0.5)),
    "A condition of ... can read": lambda: loop(faults=cosim.Freeze(start=cosim.when("controller.u", ">", 500.0))),
    "put Gain(...) between them": lambda: connected(cosim.Constant(1.0, unit="kN")),
    "their dimensions differ": lambda: connected(cosim.Constant(1.0, unit="m/s")),
    "the sizes differ": lambda: connected(cosim.Sensors(2)),
    "has no source and no start value": lambda: alone(cosim.Gain(1.0)),
    "The controller has ... sensors": lambda: loop(sensors=cosim.Sensors(3, 1.0)),
    "The model's B is": lambda: model(A=[[1, 0], [0, 1]], C=[[1, 0]]),
    "the input 'y' has the shape": lambda: controllers.StateEstimator(model()).online(compiled=False)(
        y=[1.0, 2.0, 3.0]
    ),
    "sensor_covariance is not positive": lambda: model(sensor_covariance=0.0),
    "process_covariance is not positive": lambda: model(process_covariance=-1.0),
    "refers to sensor": lambda: loop(faults=cosim.Freeze(sensor=2)),
    "The duration of": lambda: alone(cosim.Constant(1.0), 0.05),
    "no whole multiple of dt": lambda: loop(dt=0.03),
    "came out infinite": growing,
    "no control moves": lambda: two_states([[1, 0], [0, 0.9]], [[0], [1]], [[1, 0], [0, 1]], goal=[1]),
    "no sensor sees": lambda: two_states([[1.1, 0], [0, 0.9]], [[1], [1]], [[0, 1]]),
    "The goals cannot each be held": lambda: two_states([[0.9, 0], [0, 0.9]], [[1, 1], [1, 1]], [[1, 0], [0, 1]]),
    "goals but only": lambda: two_states([[1, 0.1], [0, 0.9]], [[0], [1]], [[1, 0], [0, 1]]),
    "The closed loop is unstable": servo,
    "The loop is nearly unstable": two_carts,
    "in opposite directions": lambda: controllers.compare_with_plant(
        model(B=[[-2e-4]]), car(), control="force", measured="v"
    ),
    "actuator faults cannot be inferred": lambda: controllers.BayesianController(model(), ACTUATORS, belief="joint"),
    "has no binary": lambda: alone(cosim.FMU(changed("other.fmu", drop=("binaries/", "sources/")))),
    "a draft": lambda: cosim.FMU(changed("draft.fmu", replace=(b'fmiVersion="2.0"', b'fmiVersion="3.0-beta.2"'))),
    "has no variable": lambda: car(parameters={"mass": 1.0}),
    "is a fixed parameter": lambda: car(tunable=["m"]),
    "its declaration allows": limited,
    "fmi2DoStep returned Fatal": lambda: alone(cosim.FMU(made_by_pythonfmu("raise ValueError")), engine="interpreted"),
    "could not be instantiated": lambda: alone(cosim.FMU(changed("token.fmu", replace=(b'guid="{', b'guid="{0')))),
    "crashed in its step": lambda: alone(
        cosim.FMU(made_by_pythonfmu("os.abort()"), isolate=True), engine="interpreted"
    ),
    "was ended because": lambda: alone(
        cosim.FMU(made_by_pythonfmu("time.sleep(9)"), isolate=True, time_limit=0.5), engine="interpreted"
    ),
    "cannot save and restore": lambda: circle(cosim.FMU(made_by_pythonfmu("pass")), coupling="iterated").simulate(0.1),
    "A step function may use only": lambda: alone(NotAllowed()),
    "The result has no signal": lambda: alone(cosim.Constant(1.0), 0.02)["plant.speed"],
    "give records of at least": lambda: cosim.alarm_threshold([np.zeros(100)], step=0.02),
    "has other settings in the loop": lambda: cosim.compare(
        {"a": loop(), "b": loop(sensors=cosim.Sensors(2, 2.0))}, duration=1.0
    ),
    "The campaign in": lambda: two_campaigns({"seed": 0}, {"seed": 1}),
    "A store keeps": lambda: two_campaigns({"seeds": 1}, {"seeds": 2}),
    "which cannot be exported again": lambda: cosim.export_fmu(loop(), "all.fmu"),
    "which is not installed": lambda: extra("a_package_of_no_extra", "A stored campaign"),
    "The recording ... cannot be read": lambda: cosim.Table.read("drive.csv", "speed"),
}


def pattern(words):
    return ".*".join(map(re.escape, words.split("...")))


@pytest.mark.filterwarnings("error::UserWarning")
@pytest.mark.parametrize("row", ROWS)
def test_a_message_of_the_table_is_one_that_users_get(row, tmp_path, monkeypatch):
    (provoke,) = (function for words, function in PROVOKED.items() if words in row)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises((BayesFTCError, UserWarning)) as raised:
        provoke()
    assert re.search(pattern(row), str(raised.value), re.S), str(raised.value)


def test_each_provoked_message_has_a_row():
    assert len(ROWS) == len(PROVOKED)
