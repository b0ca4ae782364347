"""How guesses of coupled values follow from each other, on iterations of known solution: no diagram, no FMU."""

import numpy as np
import pytest

from bayesftc.cosim.run.coupled import steps as _group_steps


def iterated(step, size, method, limit=40):
    """Run the arithmetic of the acceleration on a fixed point; return the gaps."""
    compute = _group_steps.build(
        lambda machine, memory, t, h, k, record: memory.__setitem__(slice(None), step(memory)) or 0,
        *[lambda machine, memory, slot: 0] * 3,
        lambda machine, memory, h: None,
    )
    memory, gaps = np.zeros(size), []
    places = np.arange(size)
    work, numbers = np.zeros((_group_steps.WORK_ROWS, size)), np.zeros(_group_steps.NUMBERS)
    record, none = np.zeros(3, dtype=np.int64), np.zeros((0, 5), dtype=np.int64)
    for most in range(1, limit):
        memory[:] = 0.0
        iteration = _group_steps.Iteration(places, places, work, numbers, 1e-12, most, method)
        doubling = _group_steps.Doubling(none, -1, 0.0, 1.0, 0.0)
        status = compute(None, memory, iteration, doubling, 0.0, 1.0, 0, record)
        gaps.append(numbers[_group_steps.GAP])
        if status == 0:
            return most, memory.copy()
    return limit, memory.copy()


@pytest.mark.slow
@pytest.mark.parametrize("size", [1, 2, 5, 12, 20])
def test_anderson_solves_a_linear_problem_in_as_many_guesses_as_values_and_two(size):
    rng = np.random.default_rng(3)
    for _ in range(5):
        a, b = rng.normal(size=(size, size)), rng.normal(size=size)
        a *= 2.0 / np.abs(np.linalg.eigvals(a)).max()  # plain iteration diverges
        count, found = iterated(lambda x, a=a, b=b: a @ x + b, size, _group_steps.ANDERSON)
        assert count <= size + 3
        np.testing.assert_allclose(found, np.linalg.solve(np.eye(size) - a, b), rtol=1e-7, atol=1e-9)


def test_aitken_and_anderson_are_the_secant_for_one_value():
    def step(x):
        return np.cos(3.0 * x)

    counts = {m: iterated(step, 1, m) for m in (_group_steps.PLAIN, _group_steps.AITKEN, _group_steps.ANDERSON)}
    assert counts[_group_steps.PLAIN][0] == 40  # it does not converge
    for method in (_group_steps.AITKEN, _group_steps.ANDERSON):
        count, found = counts[method]
        assert count < 12
        np.testing.assert_allclose(found, np.cos(3.0 * found), atol=1e-11)


def test_anderson_on_a_nonlinear_problem_with_many_values():
    rng = np.random.default_rng(1)
    a = rng.normal(size=(12, 12))
    a *= 0.9 / np.linalg.norm(a, 2)
    plain, _ = iterated(lambda x: np.tanh(a @ x) + 1.0, 12, _group_steps.PLAIN, limit=400)
    count, found = iterated(lambda x: np.tanh(a @ x) + 1.0, 12, _group_steps.ANDERSON)
    assert count < plain
    assert count < 40
    np.testing.assert_allclose(found, np.tanh(a @ found) + 1.0, atol=1e-10)
