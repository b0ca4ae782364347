"""Running a diagram: options, what is recorded, what stops a run and what then remains."""

import os
import pickle
import signal
import threading
import time

import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim import Port
from bayesftc.cosim.block import External
from bayesftc.cosim.run import running as _running


@pytest.fixture
def noisy():
    diagram = cosim.Diagram("1/30")
    noise = diagram.add(cosim.Gaussian((1.0, 2.0)), "noise")
    total, delay = diagram.add(cosim.Sum("+-+"), "total"), diagram.add(cosim.UnitDelay(), "delay")
    diagram.connect([noise["y"], delay["y"]], total["u"])
    diagram.connect(total["y"], delay["u"])
    return diagram


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_pieces_make_no_difference(noisy, engine, monkeypatch, same_bits):
    options = {"seed": 5, "engine": engine, "record": ["*", "delay.u", "noise.noise"]}
    monkeypatch.setattr(_running, "BREATH", 1e9)
    whole = noisy.simulate(20, **options)
    for breath in (0.0, 1e-5, 2e-4):
        monkeypatch.setattr(_running, "BREATH", breath)
        seen = []
        pieces = noisy.simulate(20, progress=lambda k, n, seen=seen: seen.append((k, n)), **options)
        assert seen[-1] == (600, 600)
        assert seen == sorted(set(seen))
        if breath == 0.0:
            assert len(seen) == 600
        for name in whole:
            same_bits(pieces[name], whole[name], name)


def test_both_ends_are_recorded(run_both, noisy):
    for steps in (0, 1, 63, 64, 65, 128):
        result = run_both(noisy, steps * noisy.step)
        assert len(result.time) == len(result["total.y"]) == steps + 1
        assert result.time[-1] == steps / 30
    assert result.metadata == {
        "seed": 0, "duration": 128 / 30, "step": "1/30", "engine": "compiled",
        "blocks": {"noise": "Gaussian", "total": "Sum", "delay": "UnitDelay"},
    }  # fmt: skip
    with pytest.raises(TypeError, match="sead"):
        noisy.simulate(1, sead=3)


def test_what_is_recorded(noisy, same_bits):
    every = noisy.simulate(1)
    assert list(every) == ["noise.y", "total.y", "delay.y"]
    for record, names in [
        ("total.y", ["total.y"]),
        (["delay.*", "total.u"], ["delay.y", "total.u"]),
        (["*.y", "noise.y"], ["noise.y", "total.y", "delay.y"]),
        (["[nt]o*.y"], ["noise.y", "total.y"]),
        (["noise.noise"], ["noise.noise"]),
        ([noisy["delay"]["y"], "total.y"], ["delay.y", "total.y"]),
        (noisy["delay"]["u"], ["delay.u"]),
        ([], []),
        (iter(["delay.y"]), ["delay.y"]),
    ]:
        result = noisy.simulate(1, record=record)
        assert list(result) == names
        assert len(result.time) == 31
        for name in names:
            if name in every:
                same_bits(result[name], every[name])
    for wrong, near in [
        ("totl.y", "did you mean 'total.y'"),
        ("*.z", "known names"),
        ("plant.*", "known names"),
        (3, "no signal '3'"),
    ]:
        with pytest.raises(cosim.UnknownNameError, match=r"no signal '.*' to record") as caught:
            noisy.simulate(1, record=[wrong])
        assert near.strip("'") in str(caught.value)


def test_inputs_are_recorded_as_they_are_at_t_k(run_both):
    # The source stands behind the delay, and feeds nothing that comes before it.
    diagram = cosim.Diagram(1)
    delay = diagram.add(cosim.UnitDelay(initial=-1.0), "delay")
    ramp = diagram.add(cosim.Ramp(1.0), "ramp")
    diagram.connect(ramp["y"], delay["u"])
    result = run_both(diagram, 4, record=["delay.u", "delay.y"])
    assert result["delay.u"].tolist() == [0, 1, 2, 3, 4]
    assert result["delay.y"].tolist() == [-1, 0, 1, 2, 3]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"seed": -1}, r"The seed is -1; it must be a whole number"),
        ({"seed": 2**64}, "The seed is"),
        ({"seed": 1.0}, "The seed is 1.0"),
        ({"seed": True}, "The seed is True"),
        ({"seed": None}, "The seed is None"),
        ({"seed": "1"}, "The seed is '1'"),
        ({"engine": "fast"}, "engine is 'fast'; it must be 'auto', 'compiled' or 'interpreted'"),
        ({"time_limit": -1}, "time_limit is -1"),
        ({"time_limit": float("nan")}, "time_limit is nan"),
        ({"decimation": 0}, "decimation is 0"),
        ({"record": 5}, r"record is 5; it must be names of signals or patterns"),
        ({"progress": 5}, "progress is 5; it must be a function"),
    ],
)
def test_refused_options(noisy, options, sentence):
    with pytest.raises(cosim.ModelError, match=sentence):
        noisy.simulate(1, **options)


def test_seeds(noisy, same_bits):
    same_bits(noisy.simulate(1, seed=np.uint64(7))["noise.y"], noisy.simulate(1, seed=7)["noise.y"])
    largest = noisy.simulate(1, seed=2**64 - 1)["noise.y"]
    assert not np.isclose(largest, noisy.simulate(1, seed=2**64 - 2)["noise.y"]).any()
    assert not np.isclose(largest, noisy.simulate(1, seed=2**63 - 1)["noise.y"]).any()


def test_a_recording_that_does_not_fit(noisy):
    with pytest.raises(
        cosim.ModelError, match=r"^Recording 4 numbers at .* GB, more than this machine has; record fewer signals"
    ):
        noisy.simulate(10**13)


@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_time_limit(noisy, engine):
    started = time.perf_counter()
    with pytest.raises(
        cosim.SimulationError, match=r"reached its time limit of 0\.1 s of computing at t = .* of 300000000\)"
    ) as caught:
        noisy.simulate(10**7, engine=engine, time_limit=0.1, record=["total.y"], decimation=10**4)
    assert time.perf_counter() - started < 5
    result = caught.value.result
    assert len(result.time) == len(result["total.y"]) > 0
    assert np.isfinite(result["total.y"]).all()
    copy = pickle.loads(pickle.dumps(caught.value))
    assert str(copy) == str(caught.value)
    np.testing.assert_array_equal(copy.result["total.y"], result["total.y"])


def test_an_error_in_progress_ends_the_run(noisy):
    def progress(k, steps):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        noisy.simulate(10, progress=progress)


def test_progress_is_called_about_twenty_times_a_second(noisy):
    times = []
    with pytest.raises(cosim.SimulationError):
        noisy.simulate(10**7, progress=lambda k, n: times.append(time.perf_counter()), time_limit=0.6, decimation=10**6)
    late = np.diff(times)[-8:]
    assert 0.01 < np.median(late) < 0.2


@pytest.mark.skipif(os.name == "nt", reason="sends a POSIX signal")
@pytest.mark.parametrize("engine", ["compiled", "interpreted"])
def test_ctrl_c_ends_a_run_at_once(noisy, engine):
    noisy.simulate(1, engine=engine)
    sent = []

    def send():
        sent.append(time.perf_counter())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(0.3, send)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        noisy.simulate(10**7, engine=engine, decimation=10**6)
    assert time.perf_counter() - sent[0] < 0.5  # pieces of 0.05 s, on a busy machine


class Slow(cosim.ExternalBlock):
    """Stands for an FMU that takes 20 ms a step."""

    outputs = (Port("y"),)

    def instantiate(self, step, name):
        return SlowInstance()


class SlowInstance(External):
    table = np.zeros(1, dtype=np.int64)
    closed = 0

    def output(self, inputs, outputs, t):
        outputs[0] = t
        return 0

    def update(self, inputs, outputs, t):
        time.sleep(0.02)
        return 3 if t > 0.65 else 0

    def explain(self, status):
        return f"It says {status}."

    def close(self):
        SlowInstance.closed += 1


def test_a_slow_block_is_asked_often_enough():
    diagram, seen = cosim.Diagram(0.1), []
    diagram.add(Slow(), "slow")
    with pytest.raises(cosim.SimulationError, match=r"time limit of 0.1 s"):
        diagram.simulate(1000, engine="interpreted", time_limit=0.1, progress=lambda k, n: seen.append(k))
    assert seen[0] <= 1
    assert np.diff(seen).max() <= 8
    assert SlowInstance.closed == 1


def test_an_external_failure_is_explained_and_the_instance_closed():
    SlowInstance.closed = 0
    diagram = cosim.Diagram(0.1)
    diagram.add(Slow(), "slow")
    with pytest.raises(cosim.SimulationError) as caught:
        diagram.simulate(10, engine="interpreted")
    assert str(caught.value) == "The run stopped at t = 0.7 s (step 7): block 'slow' failed. It says 3."
    assert len(caught.value.result.time) == 8  # the outputs at step 7 were there; the step to 8 failed
    assert SlowInstance.closed == 1


MEMORY = """
import json, resource, sys
from bayesftc import cosim
import numpy as np
def write(t, y):
    for i in range(y.shape[0]):
        y[i] = t + i
class Many(cosim.Block):
    outputs = (cosim.Port("y", (8,)),)
    def define(self, step):
        return cosim.Definition(write)
d = cosim.Diagram("1/1000"); d.add(Many(), "m")
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
warm = d.simulate(10); warm["m.y"]; warm.time
before = peak(); steps = int(sys.argv[1])
result = d.simulate(steps // 1000)
assert result["m.y"].shape == (steps + 1, 8) and result["m.y"][-1, 7] == steps / 1000 + 7
print(json.dumps((peak() - before) / (result["m.y"].nbytes + result.time.nbytes)))
"""


@pytest.mark.skipif(os.name == "nt", reason="reads the peak memory from POSIX")
@pytest.mark.parametrize("steps", [2_000_000, pytest.param(10_000_000, marks=pytest.mark.slow)])
def test_memory_is_the_recording(python, steps):
    assert python(MEMORY, steps) < 1.2
