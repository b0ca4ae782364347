"""Inputs that have no sample for longer than usual."""

import numpy as np
import pandas as pd

from bayesftc.cosim.base.recordings.silences import Silence, held_notes, silences
from bayesftc.cosim.fitting import sentences
from bayesftc.cosim.fitting.samples import sample

TIMES = 5.0 * np.arange(2000)


def without(start, end, times=TIMES):
    return times[(times < start) | (times >= end)]


def test_an_empty_stretch_of_a_regular_input_is_found_also_at_the_end():
    assert silences([("w", TIMES)], TIMES, TIMES[-1]) == ()
    assert silences([("w", without(3000, 4800))], TIMES, TIMES[-1]) == (Silence("w", 2995.0, 4800.0),)
    assert silences([("w", without(9000, np.inf))], TIMES, TIMES[-1]) == (Silence("w", 8995.0, TIMES[-1]),)
    assert silences([("w", without(3000, 4800))], without(2990, 4900), TIMES[-1]) == ()  # no sensor has a sample either


def test_samples_that_are_lost_one_by_one_and_stamps_that_jitter_are_none():
    rng = np.random.default_rng(0)
    times = (TIMES + rng.uniform(-1, 1, len(TIMES)))[rng.random(len(TIMES)) > 0.1]
    assert silences([("w", times)], TIMES, times[-1]) == ()


def test_an_input_that_is_logged_when_it_changes_has_none():
    rng = np.random.default_rng(0)
    for times in (
        np.cumsum(rng.exponential(60.0, 300)),
        np.cumsum(rng.lognormal(3.0, 1.5, 300)),
        np.array([0.0, 4000.0]),
    ):
        end = times[-1] + 5000.0
        assert silences([("valve", times)], np.arange(0.0, end, 5.0), end) == ()


def test_each_input_has_a_note_on_its_longest_silence_that_matters():
    found = [Silence("w", 0.0, 10.0), Silence("w", 20.0, 50.0), Silence("w", 60.0, 500.0), Silence("f", 0.0, 9.0)]
    assert list(held_notes(found, lambda _: False)) == []
    (note,) = held_notes(found, lambda each: each.name == "w" and each.end < 100)
    assert note.startswith("The input w has no sample from 20 to 50 s, and in 1 shorter time; its last value is held.")


def test_a_fit_names_an_input_only_where_samples_count_as_faulty_in_its_silence():
    table = pd.DataFrame({"t": TIMES, "w": np.sin(TIMES), "y": np.cos(TIMES)})
    table.loc[(TIMES >= 3000) & (TIMES < 4800), "w"] = np.nan
    samples = sample(table, {"load": "w"}, "y", None, None)
    assert samples.silences == (Silence("w", 2995.0, 4800.0),)
    present = np.isfinite(samples.y)
    for start, named in ((2000, False), (4000, True), (6000, False)):
        weights = np.ones((len(TIMES), 1))
        weights[start // 5 : start // 5 + 100] = 0.0
        notes = list(sentences.held(samples.silences, weights, ~present, present, TIMES))
        assert bool(notes) == named


def test_a_gap_of_the_whole_recording_is_no_silence_of_an_input():
    table = pd.DataFrame({"t": TIMES, "w": np.sin(TIMES), "y": np.cos(TIMES)})
    gap = (TIMES >= 3000) & (TIMES < 4800)
    assert sample(table[~gap], {"load": "w"}, "y", None, None).silences == ()
