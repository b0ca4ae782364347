"""A small campaign whose numbers say which run they are of, and processes that write it until they are killed."""

import os
import random
import sys
import time
from pathlib import Path

import numpy as np

from bayesftc.cosim.campaign.designs.plan import FAILED, OK, Outcome, Piece, Plan
from bayesftc.cosim.campaign.store.folder import CampaignStore

TIME = np.arange(5) * 0.1
SIGNALS = {"plant.v": ((), "m/s"), "filter.x/y": ((2,), None), "filter.P": ((2, 3), None)}
POINTS = (
    {"a.b": 1.5, "kind": "none", "on": True, "n": 1, "seed": None},
    {"a.b": np.float64(2.5), "kind": "bias", "on": False, "n": np.int64(2), "seed": 3},
)
PLAN = Plan(POINTS, ((1, 2, 3), (1, 2, 3, 4)), 3)


def outcome(piece, signals=SIGNALS, rows=5, fail=(), salt=0, metrics=("m.1", "m.2")):
    """Return numbers that say of themselves which run, row and element they are; those of failed runs end with NaN."""
    runs = np.arange(piece.begin, piece.end)
    failed = np.isin(runs, list(fail))
    values = {}
    for k, (name, (shape, _)) in enumerate(signals.items()):
        row = np.arange(rows)[None, :] / 64 + runs[:, None] + 1000 * (k + 1 + salt)
        element = np.arange(np.prod(shape, dtype=int)).reshape(shape) * 1e6
        values[name] = row.reshape(*row.shape, *(1 for _ in shape)) + element
        values[name][failed, rows // 2 :] = np.nan
    numbers = {name: np.where(failed, np.nan, runs / (k + 3) + salt) for k, name in enumerate(metrics)}
    status = tuple(FAILED if f else OK for f in failed)
    reasons = tuple("the plant gave NaN" if f else "" for f in failed)
    return Outcome(piece, numbers, values, status, reasons, np.where(failed, rows // 2 - 1, rows - 1), 0.25)


def create(path, plan=PLAN, **changes):
    arguments = {"description": {"scenario": "car"}, "signals": SIGNALS, "time": TIME, "metrics": ("m.1", "m.2")}
    return CampaignStore.create(path, plan=plan, **(arguments | changes))


def resume(path, plan=PLAN, **changes):
    arguments = {"description": {"scenario": "car"}, "signals": SIGNALS, "time": TIME, "metrics": ("m.1", "m.2")}
    return CampaignStore.resume(path, plan=plan, **(arguments | changes))


def assert_piece(store, piece, *candidates):
    """Check that rows and signals of a piece are those of one of some outcomes, by the table and both ways to the signals."""
    table, data = store.table().set_index("run"), store.dataset()
    rows = table.loc[piece.begin : piece.end - 1]
    assert len(rows) == len(piece)
    (read,) = (signals for p, signals in store.pieces_of_signals() if p == piece)

    def same(candidate):
        pairs = [(rows[name].to_numpy(), values) for name, values in candidate.metrics.items()]
        pairs += [(read[name], values) for name, values in candidate.signals.items()]
        pairs += [
            (data[name][piece.begin : piece.end].to_numpy(), values) for name, values in candidate.signals.items()
        ]
        lists = [
            (rows["status"], candidate.status),
            (rows["reason"], candidate.reasons),
            (rows["steps"], candidate.steps),
        ]
        return all(np.array_equal(a, b, equal_nan=True) for a, b in pairs) and all(
            a.tolist() == list(b) for a, b in lists
        )

    assert any(map(same, candidates)), f"{piece} is none of what it may be"


def assert_whole(store, plan=PLAN, of=outcome):
    """Check that each run is there once, with the values that it must have."""
    assert store.whole
    assert store.table()["run"].tolist() == list(range(plan.runs))
    for piece in plan.pieces:
        assert_piece(store, piece, of(piece))


def hold(path, forks):
    """Write a campaign, and do nothing; with `forks` the parent of a process that does nothing either."""
    with create(Path(path)):
        child = os.fork() if int(forks) else 0
        if child or not int(forks):
            sys.stdout.write(f"ready\n{child}\n")
            sys.stdout.flush()
        time.sleep(600)


DRILL = Plan(({"gain": 1.0}, {"gain": 2.0}), (tuple(range(200)), tuple(range(190))), 4)


def drilled(piece):
    return outcome(piece, fail=range(0, 390, 7))


def write_all(path, seed):
    """Write what is not there yet, finish, and replace failed runs by the same runs, until someone ends it."""
    path, chance = Path(path), random.Random(seed)
    store = resume(path, DRILL) if path.exists() else create(path, DRILL)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    left = [piece for piece in DRILL.pieces if piece.index not in store.done()]
    chance.shuffle(left)
    for piece in left:
        store.write(drilled(piece))
    while True:
        store.finish()
        failed = store.failed()
        for run in chance.sample(failed, 5):
            store.replace(drilled(Piece(0, run, run + 1)))


if __name__ == "__main__":
    {"hold": hold, "write_all": write_all}[sys.argv[1]](*sys.argv[2:])
