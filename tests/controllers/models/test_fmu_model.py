"""Nonlinear models of FMUs: against the textbook's equations, and what is refused."""

import inspect
import pickle
import re
import subprocess
import zipfile
from pathlib import Path

import cloudpickle
import numpy as np
import pytest
from numpy.testing import assert_allclose

from bayesftc import cosim, fmus
from bayesftc.controllers import NonlinearModel
from bayesftc.cosim.errors import ModelError, UnknownNameError
from bayesftc.examples.foreign_fmus.makers import tanks

DT, PARTS = 0.02, 4


def cart_rate(s, force, m=0.2, M=0.5, length=0.3, inertia=0.006, c=0.1, b=1e-3, g=9.81):
    """The pendulum on a cart, from the textbook: a mass matrix and forces."""
    _, angle, velocity, rate = s
    mass = np.array([[M + m, m * length * np.cos(angle)], [m * length * np.cos(angle), inertia + m * length**2]])
    forces = [
        force - c * velocity + m * length * rate**2 * np.sin(angle),
        m * g * length * np.sin(angle) - b * rate,
    ]
    return np.concatenate([s[2:], np.linalg.solve(mass, forces)])


def arm_rate(s, torque):
    """The arm with two links, from the textbook."""
    I1, I2, m1, m2, L1, Lg1, Lg2, g = 1.0209, 1.0218, 2.1368, 2.2418, 1.0446, 0.5451, 0.5075, 9.81
    q1, q2, v1, v2 = s
    k = m2 * L1 * Lg2
    far = I2 + m2 * Lg2**2
    mass = np.array([
        [I1 + m1 * Lg1**2 + m2 * L1**2 + far + 2 * k * np.cos(q2), far + k * np.cos(q2)],
        [far + k * np.cos(q2), far],
    ])  # fmt: skip
    coriolis = k * np.sin(q2) * np.array([-v2 * (2 * v1 + v2), v1**2])
    outer = m2 * Lg2 * np.cos(q1 + q2)
    gravity = g * np.array([(m1 * Lg1 + m2 * L1) * np.cos(q1) + outer, outer])
    return np.array([v1, v2, *np.linalg.solve(mass, torque - coriolis - [101.519, 103.8566] * s[2:] - gravity)])


def stepped(rate, x, u, parts, dt=DT):
    h = dt / parts
    for _ in range(parts):
        k1 = rate(x, u)
        k2 = rate(x + h / 2 * k1, u)
        k3 = rate(x + h / 2 * k2, u)
        k4 = rate(x + h * k3, u)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def differences(function, x, step=1e-5):
    columns = [(function(x + step * e) - function(x - step * e)) / (2 * step) for e in np.eye(len(x))]
    return np.column_stack(columns)


def plant(name, fmi="2.0"):
    return cosim.FMU(fmus.path(name, fmi=fmi), parameters={"max_substep": DT / PARTS})


CASES = {
    "CartPendulum": (cart_rate, ["position", "angle"], ["force"], [0.5, 1.0, 2.0, 3.0], 10.0),
    "TwoLinkArm": (arm_rate, ["q1", "q2"], ["torque1", "torque2"], [2.0, 2.0, 1.0, 1.0], 100.0),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize("name", CASES)
def test_shipped_plants_step_from_any_state_as_the_textbook_says(name, fmi):
    rate, measured, actuated, size, force = CASES[name]
    model = NonlinearModel.from_fmu(plant(name, fmi), measured=measured, actuated=actuated, dt=DT)
    n, p = model.states, model.controls
    following, F, B, y = np.empty(n), np.empty((n, n)), np.empty((n, p)), np.empty(2)

    def exact(x, u):
        return stepped(rate, x, u[0] if p == 1 else u, PARTS)

    rng = np.random.default_rng(3)
    for x, u in zip(rng.normal(size=(10, n)) * size, force * rng.normal(size=(10, p)), strict=True):
        model.f(x, u, following)
        model.f_jacobian(x, u, F, B)
        model.g(x, y)
        assert_allclose(following, exact(x, u), rtol=1e-11, atol=1e-12)
        assert_allclose(F, differences(lambda x, u=u: exact(x, u), x), atol=3e-8)
        assert_allclose(B, differences(lambda u, x=x: exact(x, u), u), atol=3e-8)
        assert y.tolist() == x[:2].tolist()


def test_outputs_that_are_no_states_come_from_the_fmu():
    model = NonlinearModel.from_fmu(plant("TwoLinkArm"), measured=["x", "q1"], actuated=["torque1", "torque2"], dt=DT)
    x, y, C = np.array([0.3, -0.4, 1.0, 2.0]), np.empty(2), np.empty((2, 4))
    model.g(x, y)
    model.g_jacobian(x, C)
    assert_allclose(y, [1.0446 * np.cos(0.3) + 1.0111 * np.cos(-0.1), 0.3], rtol=1e-14)
    slope = [-1.0446 * np.sin(0.3) - 1.0111 * np.sin(-0.1), -1.0111 * np.sin(-0.1), 0, 0]
    assert_allclose(C, [slope, [1, 0, 0, 0]], atol=1e-9)
    assert model.names.states == ("q1", "q2", "dq1", "dq2")
    assert model.start == (-np.pi / 2, 0.0, 0.0, 0.0)


def test_the_process_covariance_is_the_effect_of_noise_at_inputs():
    options = {"measured": ["position", "angle"], "actuated": "force", "dt": DT}
    model = NonlinearModel.from_fmu(
        plant("CartPendulum"), noise={"torque": 0.3}, sensors=4, sensor_std=[0.1, 0.2], **options
    )
    m, M, length, inertia = 0.2, 0.5, 0.3, 0.006
    effect = np.linalg.solve([[M + m, m * length], [m * length, inertia + m * length**2]], [0.0, 1.0])
    speeds = np.sqrt(np.diag(np.asarray(model.process_covariance))[2:])
    assert_allclose(speeds, 0.3 * DT * np.abs(effect), rtol=0.01)
    assert_allclose(np.diag(np.asarray(model.sensor_covariance)), [0.01, 0.04, 0.01, 0.04])
    given = NonlinearModel.from_fmu(plant("CartPendulum"), process_covariance=[1, 2, 3, 4], disturbance=0.5, **options)
    assert_allclose(np.asarray(given.process_covariance), np.diag([1, 2, 3, 4, 0.5]))


def test_a_pickled_model_computes_the_same():
    model = NonlinearModel.from_fmu(plant("CartPendulum"), measured="angle", actuated="force", dt=DT)
    copy = pickle.loads(cloudpickle.dumps(model))
    x, results = np.array([0.1, 0.2, 0.3, 0.4]), np.empty((2, 4))
    for each, following in zip((model, copy), results, strict=True):
        each.f(x, np.ones(1), following)
    assert results[0].tolist() == results[1].tolist()


CART = {"measured": ["position", "angle"], "actuated": "force", "dt": DT}
REFUSED = {
    "a state is missing": ({"states": {"position": "position_0", "angle": "angle_0", "rate": "rate_0"}},
                           ModelError, "is not the FMU's own step: .* States may be missing in states="),
    "unknown": ({"states": {"angel": "angle_0"}}, UnknownNameError, "no variable 'angel'; did you mean 'angle'"),
    "not settable": ({"states": ["position", "angle"]}, ModelError, "'position' of .* cannot be set before initialization"),
    "no states": ({"states": {}}, ModelError, "The states of the FMU 'cartpendulum' are not known"),
    "substeps": ({"substeps": 3}, ModelError, "substeps= is for FMUs for model exchange"),
    "two noises": ({"noise": {"torque": 1}, "process_covariance": 1.0}, ModelError, "leave one of them out"),
    "unknown input": ({"actuated": "forse"}, UnknownNameError, "'forse'; did you mean 'force'"),
    "no name": ({"measured": 3}, ModelError, "measured=3; give the name of at least one variable"),
    "no list of names": ({"actuated": [["force"]]}, ModelError, r"actuated=\[\['force'\]\]; give the name"),
    "unknown output": ({"measured": "angel"}, UnknownNameError, "'angel'; did you mean 'angle'"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refusals(case):
    options, error, message = REFUSED[case]
    with pytest.raises(error, match=message):
        NonlinearModel.from_fmu(plant("CartPendulum"), **CART | options)


def test_refused_fmus():
    with pytest.raises(ModelError, match=r"needs an FMU block or the path of an \.fmu file, not 3"):
        NonlinearModel.from_fmu(3, **CART)
    with pytest.raises(ModelError, match="is isolated"):
        NonlinearModel.from_fmu(cosim.FMU(fmus.path("CartPendulum"), isolate=True), **CART)


def test_an_fmu_of_python_that_cannot_save_its_state_is_refused(tmp_path):
    pytest.importorskip("pythonfmu")
    with pytest.raises(ModelError, match="'tanks' is for co-simulation and cannot save its state"):
        NonlinearModel.from_fmu(tanks(tmp_path), measured="level", actuated="pump", states=["level"])


def test_an_output_that_depends_on_an_input_is_refused(casadi_fmu):
    path = casadi_fmu("direct", lambda q, u: q + 0.5 * u)
    with pytest.raises(ModelError, match="output y of the FMU 'direct' depends directly on the input u"):
        NonlinearModel.from_fmu(path, measured="y", actuated="u", dt=DT)
    with pytest.raises(ModelError, match="its states are known; leave states= out"):
        NonlinearModel.from_fmu(path, measured="y", actuated="u", dt=DT, states=["q"])


CURVED = Path(__file__).parents[2] / "cosim/fmi/prediction/curved.c"
DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="curved" guid="curved" numberOfEventIndicators="0">
<ModelExchange modelIdentifier="curved" completedIntegratorStepNotNeeded="true"/>
<ModelVariables>
<ScalarVariable name="x" valueReference="0" causality="local" initial="exact"><Real start="0.5"/></ScalarVariable>
<ScalarVariable name="v" valueReference="1" causality="local" initial="exact"><Real start="0"/></ScalarVariable>
<ScalarVariable name="der(x)" valueReference="2" causality="local"><Real derivative="1"/></ScalarVariable>
<ScalarVariable name="der(v)" valueReference="3" causality="local"><Real derivative="2"/></ScalarVariable>
<ScalarVariable name="u" valueReference="4" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="y" valueReference="5" causality="output"><Real/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="6"/></Outputs>
<Derivatives><Unknown index="3"/><Unknown index="4"/></Derivatives></ModelStructure>
</fmiModelDescription>"""


@pytest.fixture
def curved_in_time(tmp_path, c_compiler):
    """Build the FMU of curved.c with a term of the time in the derivative of v, and one in y."""
    import fmpy
    from fmpy.fmi2 import FMU2Model

    def build(derivative="0.0", output="0.0"):
        text = CURVED.read_text()
        for old, new in (
            ("int failed; } Instance", "int failed; double t; } Instance"),
            ("SetTime(fmi2Component c, fmi2Real t) {", "SetTime(fmi2Component c, fmi2Real t) { M->t = t;"),
            ("cos(m->x[0]);\n    case 4", f"cos(m->x[0]) + {derivative};\n    case 4"),
            ("return m->x[0] * m->x[1];", f"return m->x[0] * m->x[1] + {output};"),
        ):  # fmt: skip
            assert old in text
            text = text.replace(old, new)
        names = [name for name, _ in inspect.getmembers(FMU2Model) if name.startswith("fmi2")]
        absent = [f"int {name}(void) {{ return 3; }}\n" for name in names if not re.search(rf"\b{name}\b", text)]
        (tmp_path / "curved.c").write_text(text)
        (tmp_path / "absent.c").write_text("".join(absent))
        library = tmp_path / f"curved{fmpy.sharedLibraryExtension}"
        sources = [str(tmp_path / "curved.c"), str(tmp_path / "absent.c")]
        flags = ["-shared", "-fPIC", "-O1", "-w", f"-I{Path(fmpy.__file__).parent / 'c-code'}"]
        subprocess.run([c_compiler, *flags, *sources, "-o", str(library), "-lm"], check=True)
        with zipfile.ZipFile(tmp_path / "curved.fmu", "w") as archive:
            archive.writestr("modelDescription.xml", DESCRIPTION)
            archive.write(library, f"binaries/{fmpy.platform}/{library.name}")
        return tmp_path / "curved.fmu"

    return build


TIMES = {
    "a switch after the ten steps": ({"derivative": "(m->t > 1.0 ? 5.0 : 0.0)"}, "the derivative of v is .* at t = 1.3 s"),
    "a late switch": ({"derivative": "(m->t > 900.0 ? 5.0 : 0.0)"}, "the derivative of v is .* at t = 1009.3 s"),
    "a slow drift": ({"derivative": "2e-5 * m->t"}, "the derivative of v is"),
    "only while the plant moves": ({"derivative": "m->x[1] * sin(m->t)"}, "the derivative of v is"),
    "an output": ({"output": "(m->t > 1.0 ? 0.1 : 0.0)"}, "inputs, y is 0 at t = 0 s and 0.1 at t = 1.3 s"),
    "one second's period": ({"derivative": "sin(6.283185307179586 * m->t)"}, "the derivative of v is"),
}  # fmt: skip


@pytest.mark.sampled(1)
@pytest.mark.parametrize("case", TIMES)
def test_an_fmu_that_depends_on_time_is_refused(case, curved_in_time):
    terms, message = TIMES[case]
    with pytest.raises(ModelError, match=f"'curved' depends on time, .* {message}"):
        NonlinearModel.from_fmu(curved_in_time(**terms), measured="y", actuated="u", dt=DT)


def test_an_fmu_that_ignores_the_time_is_accepted(curved_in_time):
    assert NonlinearModel.from_fmu(curved_in_time(), measured="y", actuated="u", dt=DT).start == (0.5, 0.0)
