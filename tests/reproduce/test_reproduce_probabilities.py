"""Fault probabilities over random faults, small: what is drawn, and the numbers of the report by other ways of computing them."""

import json
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from bayesftc import controllers, cosim, reproduce
from bayesftc.controllers import Calibration
from bayesftc.cosim.errors import ModelError
from bayesftc.reproduce.experiments.probabilities import (
    exact_cases as _exact_cases,
    figures as _probabilities_figures,
    run as _probabilities,
    tables as _probabilities_tables,
)
from bayesftc.reproduce.experiments.probabilities.random_faults import KINDS, random_fault
from bayesftc.reproduce.settings import Car, Probabilities, Tracking
from bayesftc.reproduce.shared.ensemble import Ensemble

FEW = {
    "shifts": controllers.SwitchingPrecision((controllers.Offset(),), joint=False),
    "noise": controllers.SwitchingPrecision((controllers.Noisier(),), joint=False),
}
SMALL = Probabilities(
    runs=3, duration=3.0, starts=(0.5, 1.0), lengths=((0.5, 1.0), (0.2, 0.3)), enough=20, samples=3, sequences=1
)


def small(jobs):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_exact_cases, "ROWS", {name: _exact_cases.ROWS[name] for name in ("DroppedOut", "Ramping")})
        return reproduce.probabilities(seed=3, jobs=jobs, settings=SMALL, learners=FEW)


@pytest.fixture(scope="module")
def report():
    return small(2)


def test_faults_are_of_all_kinds_and_within_their_ranges():
    settings, lengths = Probabilities(), Probabilities().lengths[0]
    drawn = [random_fault(settings, lengths, 2, seed) for seed in range(300)]
    assert {fault.kind for fault in drawn} == set(KINDS) == {name for name, *_ in settings.kinds}
    assert random_fault(settings, lengths, 2, 7) == drawn[7] != drawn[8]
    sizes = {name: (low, high) for name, low, high in settings.kinds}
    for one in drawn:
        low, high = sizes[one.kind]
        for fault in one.faults:
            assert settings.starts[0] <= fault.start <= settings.starts[1]
            assert lengths[0] <= fault.stop - fault.start <= lengths[1]
            assert fault.stop <= settings.duration
            match fault:
                case cosim.Injection(amplitude=size) if size:
                    assert settings.periods[0] <= fault.period <= settings.periods[1]
                case cosim.Injection(magnitude=size) | cosim.Drift(slope=size):
                    pass
                case cosim.GainFault(factor=size) | cosim.Lag(time_constant=size):
                    pass
                case cosim.NoiseIncrease(std=size):
                    size = (1 + size**2) ** 0.5 if one.kind == "noise" else size
                case cosim.Freeze():
                    size = low
            assert low * (1 - 1e-12) <= abs(size) <= high * (1 + 1e-12)
    assert {fault.sensor for one in drawn for fault in one.faults} == {0, 1}
    assert {np.sign(one.faults[0].magnitude) for one in drawn if one.kind == "injection"} == {-1.0, 1.0}


def test_the_truth_is_the_window_of_the_fault():
    fault = replace(
        random_fault(Probabilities(), (1.0, 2.0), 2, 0), faults=(cosim.Freeze(sensor=1, start=2.0, stop=4.0),)
    )
    assert fault.truth(np.array([1.9, 2.0, 3.9, 4.0]), 2).tolist() == [[0, 0], [0, 1], [0, 1], [0, 0]]


def test_the_gaps_are_those_of_all_samples(report):
    """Each run again by itself; bins counted one by one."""
    for lengths, title in zip(SMALL.lengths, report["reliability"], strict=True):
        ensemble = Ensemble(3)
        faults = [
            random_fault(SMALL, lengths, 2, seed)
            for seed in ensemble.seeds(f"probabilities/faults/{title}", SMALL.runs)
        ]
        seeds = ensemble.seeds("probabilities/noise", SMALL.runs)
        reference = cosim.Sine(5.0, 8.0, offset=20.0)
        said, there, kinds = [], [], []
        for fault, seed in zip(faults, seeds, strict=True):
            loop = _probabilities.closed_loop(Car(), FEW["shifts"], fault.faults, reference, 20.0)
            result = loop.simulate(3.0, seed=seed)
            said.append(result["controller.fault_probability"])
            there.append(fault.truth(result.time, 2))
            kinds.append(np.full(said[-1].shape, fault.kind))
        said, there, kinds = (np.concatenate(each).ravel() for each in (said, there, kinds))
        for b, of in enumerate(report["reliability"][title]["shifts"]["bins"]):
            here = (said >= b / 10) & ((said < (b + 1) / 10) | (b == 9))
            assert of["samples"] == here.sum()
            if here.any():
                assert of["predicted"] == pytest.approx(said[here].mean())
                assert of["observed"] == pytest.approx(there[here].mean())
                assert sum(of["by_kind"].values()) == pytest.approx(of["gap"], abs=1e-12)
                for kind, part in of["by_kind"].items():
                    own = here & (kinds == kind)
                    assert part == pytest.approx((said[own] - there[own]).sum() / here.sum(), abs=1e-12)
            else:
                assert of["observed"] is None


def made_up(honest, runs=60, steps=400):
    """Return runs of which each probability happens as often as it says, or as its square says."""
    rng = np.random.default_rng(5)
    p = rng.random((runs, steps, 1))
    return [_probabilities.Run(one, rng.random(one.shape) < (one if honest else one**2)) for one in p]


def test_honest_probabilities_are_on_the_diagonal_and_others_are_not():
    settings = Probabilities()
    found = {honest: _probabilities.judged(settings, made_up(honest), ["freeze"] * 60) for honest in (True, False)}
    low, high = found[True]["largest"]["ci"]
    assert found[True]["largest"]["distance"] < 0.03 < settings.bar
    assert low <= found[True]["largest"]["distance"] < high < 0.06
    worst = found[False]["largest"]
    assert worst["distance"] == pytest.approx(0.25, abs=0.03)
    assert worst["ci"][0] < worst["distance"] < worst["ci"][1]
    assert worst["bin"] in (4, 5)
    rare = _probabilities.judged(replace(settings, enough=10**6), made_up(False), ["freeze"] * 60)
    assert np.isnan(rare["largest"]["distance"])
    assert rare["largest"]["bin"] is None


def test_learners_are_told_what_the_runs_are_like():
    """Mean times by a sum over the drawn faults; all modes of a sensor together begin as often as its faults do."""
    settings, lengths = Probabilities(), (0.5, 6.0)
    drawn = [random_fault(settings, lengths, 2, seed).faults[0] for seed in range(4000)]
    mean = np.mean([fault.stop - fault.start for fault in drawn])
    to_fault, to_recovery = _probabilities.mean_times(settings, lengths, Car())
    assert to_recovery == pytest.approx(mean, rel=0.05)
    assert to_fault == pytest.approx(2 * settings.duration - mean, rel=0.01)
    assert _probabilities.mean_times(settings, (2.0, 2.0), Car()) == (58.0, 2.0)
    fitted = controllers.CalibrationReport(Calibration(1.0, 2.0), *[0.0] * 5, samples=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(controllers, "calibrate", lambda model, hazards, precision: fitted)
        known = _probabilities.judged_learners(settings, lengths, Car())
    default, single, told, larger, gamma = known.values()
    assert (default, single) == (controllers.SwitchingPrecision(), controllers.SwitchingPrecision(joint=False))
    assert sum(1 / mode.time_to_fault for mode in told.modes) == pytest.approx(1 / to_fault)
    assert {mode.time_to_recovery for mode in told.modes} == {to_recovery}
    changed = [(a, b) for a, b in zip(default.modes, larger.modes, strict=True) if a != b]
    assert changed == [(controllers.Offset(), controllers.Offset(jump=3.0))]
    assert gamma == controllers.GammaPrecision(calibration=Calibration(1.0, 2.0))


def shown(report):
    console = Console(file=StringIO(), width=160)
    for part in _probabilities_tables.show(report):
        console.print(part)
    return " ".join(console.file.getvalue().split())


def test_what_is_printed_and_drawn(report):
    text = shown(report)
    for title, learners in report["reliability"].items():
        assert f"3 runs with random faults of {title}" in text
        for name, of in learners.items():
            assert f"{name} {of['largest']['distance']:.3f}" in text
    assert f"{report['exact']['DroppedOut']['default times']['joint']['largest']:.3f}" in text
    figure = _probabilities_figures.reliability(report)
    assert [axis.get_title(loc="left") for axis in figure.axes[:2]] == [
        "faults of 0.5 to 1 s",
        "faults of 0.2 to 0.3 s",
    ]
    (line,) = (c.lines[0] for c in figure.axes[0].containers if c.get_label() == "shifts")
    bins = [b for b in report["reliability"]["0.5 to 1 s"]["shifts"]["bins"] if b["samples"] >= SMALL.enough]
    assert np.allclose(line.get_ydata(), [b["observed"] for b in bins])


def test_kinds_are_named_where_a_bin_is_beyond_the_bar():
    found = _probabilities.judged(Probabilities(), made_up(False), ["freeze", "gain"] * 30)
    words = _probabilities_tables._causes(Probabilities().to_dict(), "mine", found)
    assert words.startswith("mine: beyond 0.1 in 0.1-0.2 by +0.1")
    assert "0.4-0.5 by +0.25 (freeze +0.1" in words.replace("gain", "freeze")
    honest = _probabilities.judged(Probabilities(), made_up(True), ["freeze"] * 60)
    words = _probabilities_tables._causes(Probabilities().to_dict(), "mine", honest)
    assert words == "mine: within 0.1 in every bin with 200 samples."


def test_the_report_is_the_same_for_any_number_of_jobs_and_says_why(report):
    assert small(1) == report
    json.dumps(report, allow_nan=False)
    for name in vars(Probabilities()):
        assert len(report["settings"]["why"][name]) > 5
    assert report["settings"]["learners"]["0.5 to 1 s"] == {name: repr(learner) for name, learner in FEW.items()}
    assert set(report["exact"]["Ramping"]["frequent faults"]) == {"between", "joint"}
    assert list(report["exact"]["DroppedOut"]["default times"]["joint"]["by_size"]) == ["0", "1"]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: reproduce.probabilities(runs=1), "runs is 1"),
        (lambda: reproduce.probabilities(settings=Tracking()), "takes Probabilities"),
        (lambda: Probabilities(starts=(2.0, 1.0)), "starts is"),
        (lambda: Probabilities(lengths=((0.0, 1.0),)), "lengths is"),
        (lambda: Probabilities(samples=2), "samples is 2"),
        (lambda: Probabilities(jump=0.0), "jump=0"),
    ],
)
def test_wrong_input_is_a_sentence(make, words):
    with pytest.raises(ModelError, match=words):
        make()
