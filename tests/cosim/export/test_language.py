"""What of Python a step function may use and still become C, and the sentences for what it may not."""

import linecache
import re

import control
import numpy as np
import pytest

from bayesftc import cosim
from bayesftc.cosim import ops
from bayesftc.cosim.export.c_file import write_c
from bayesftc.cosim.export.program import program_of
from bayesftc.cosim.ops import both, either, exp, floor, isnan, log, maximum, minimum, negate, select, sqrt, square


class Written(cosim.Block):
    """A block of three inputs and four outputs around a step function."""

    def __init__(self, kernel, update=None, **parameters):
        self.kernel, self.update, self.parameters = kernel, update, parameters

    inputs = (cosim.Port("u", (3,)),)
    outputs = (cosim.Port("y", (4,)),)

    def define(self, step):
        return cosim.Definition(
            self.kernel,
            self.update,
            state={"x": [1.0, -2.0], "X": [[1.0, 2.0], [3.0, 4.0]]},
            parameters=self.parameters,
        )


def returned(a, b):
    return a + b, a - 2.0 * b


def touched(x, i, by=0.5):
    x[i] = x[i] + by
    return x[i]


def without_value(x):
    if x[0] > 5.0:
        return
    x[0] = x[0] + 1.0


def largest(x):
    found = x[0]
    for i in range(1, x.shape[0]):
        if x[i] > found:
            found = x[i]
    return found


def row_sum(row):
    total = 0
    for i in range(len(row)):
        total = total + row[i]
    return total


TABLE, FLAGS, CHOICES = (3, 1, 2), (True, False, True), ((0.5, 2.0), (-1.0, 4.0))


def numbers(u, y, k):
    y[0] = u[0] - u[1] - u[2] - (u[0] - (u[1] - u[2])) / 3 * -u[0] / (u[1] / u[2]) + 1e-300 * 2
    y[1] = -u[0] * 2 + +u[1] - (-(u[2] - -u[0])) + 123456789012 * k
    y[2] = (k + 7) // 3 + (k - 9) // 4 - (k - 5) % 3 + k / 2 + 1 / 3
    y[3] = (u[0] + u[1]) * (u[2] - u[0]) / (u[1] * u[2])


def operations(u, y):
    y[0] = select(both(u[0] > 0, negate(u[1] > 0)), sqrt(u[0]), square(u[1])) + select(
        either(u[2] < 0, isnan(u[2])), 1, 2
    )
    y[1] = maximum(minimum(u[0], 1), -1.0) + floor(u[1]) + ops.absolute(u[2]) + ops.sin(u[0]) * ops.cos(u[1])
    y[2] = exp(u[0]) + log(ops.absolute(u[1])) + exp(1.0) + select(u[0], 1.0, 2.0)
    y[3] = 1.0 if 0 < u[0] <= 1 < u[1] + 2 else (0.0 if (u[0] != u[1] and not u[2] > 0.5) or u[1] >= 3 else -1.0)


def loops(u, y, X, k):
    count = 0
    total = 0.0
    for i in range(5):
        if i == 3:
            continue
        count = count + i
        for j in range(i, -1, -1):
            total = total + u[j % 3] * (i - j)
        if u[0] > 0 and i > 2:
            break
    else_where = 10
    while else_where > 4:
        else_where = else_where - 2
    end = 2
    for i in range(end):
        end = 0
        total += i * 0.25
    i = 7
    y[0], y[1], y[2] = total, count + i, else_where
    y[3] = X[1, 0] + X[-1, -1] + X[k % 2, 1] + TABLE[k % 3] + (1.0 if FLAGS[k % 3] else 0.0) + CHOICES[1][0]


def order(u, y, x):
    a, b = u[0], u[1]
    a, b = b, a
    x[0], x[1] = x[1], x[0]
    y[0] = x[0] * touched(x, 0) + x[0]
    y[1] = touched(x, 1, by=2.0) - touched(x, i=1) * a + b
    without_value(x)
    y[2] = y[3] = largest(u) + x[0]
    first, second = returned(y[2], a)
    y[3] = first * second


def rows(u, y, X):
    row = X[1]
    row[0] = row[0] + u[0]
    y[0] = row_sum(row) + row_sum(X[0]) + row_sum(u)
    y[1], y[2] = X[0][1], X[1][-1]
    double = 2
    y[3] = double * X.shape[0] * X.size * X.ndim
    y[3] /= 7


def branches(u, y, x):
    gain = 1
    if u[0] > 0.3:
        gain = 2.5
    elif u[0] > 0:
        gain = x[0]
    else:
        y[0] = 0.0
    y[0] = gain
    y[1] = y[2] = 0.0
    if FLAGS[1]:
        y[1] = undefined_anywhere  # noqa: F821
    y[3] = u[0] if TABLE[0] == 3 else x


def aliases(u, y, X, k):
    """Rows that change places, and a row taken by an index that changes in the same line."""
    row, other = X[0], X[1]
    row, other = other, row
    i = 1
    i, row = 0, X[i]
    row[0] = row[0] + u[0]
    other[1] = other[1] - u[1]
    y[0], y[1], y[2], y[3] = X[0, 0], X[1, 0], X[0, 1], row[1] + other[0] + i


def call_order(u, y, x):
    """Calls in the order in which they are written, each made once."""
    y[0] = returned_first(b=touched(x, 0), a=touched(x, 0, 3.0))
    flag = touched(x, 1) > 0.0 and u[0] > 0.0
    double = double_ = touched(x, 1)
    touched(x, 0)
    y[1], y[2], y[3] = x[1], (1.0 if flag else 0.0) + double * double_, minimum(x[0], b=0.5)
    unread = touched(x, 0)  # noqa: F841
    product = minimum(0.25, u[0]) * u[1]  # noqa: F841


def returned_first(a, b):
    return forwarded(a, b)


def forwarded(a, b):
    return a - 3.0 * b


def hidden_names(u, y):
    """Names that are one in C unless they are told apart, and such as the C has itself."""
    double, double_, t_1, t_2, größe, gru00f6u00dfe = u[0], u[1], u[2], 3.0, 4.0, 5.0
    INT64_C, Record_ff, size_t = 1.0, 2.0, 3.0
    first, second = returned(double, double_)
    y[0], y[1], y[2] = first + t_1 * t_2, second + größe / gru00f6u00dfe, INT64_C + Record_ff + size_t
    y[3] = t_1 = t_2 = touched(y, 0) * t_2


def truth(u, y, k):
    """Truth values that are counted with, and whole numbers that no 32 bits hold."""
    large = (u[0] > 0) * 2147483647 + 2147483647 + k
    y[0] = large * (u[1] > 0) + k // (3 if u[0] > 0 else -2)
    y[1] = u[2] - (0.0 - (k - k)) + -0.0
    y[2], y[3] = large, 9007199254740993 * u[0] + 9007199254740993


def choices(u, y, k):
    """Choices of whole numbers that 32 bits hold, counted with beyond them: C takes a choice of two literals for an int."""
    y[0] = (3 if u[0] > 0 else 2) * 2000000000
    y[1] = -(2147483647 if u[1] > 0 else -5) - 7
    y[2] = (2147483647 if u[0] > 0 else 1) + (2147483647 if u[1] > 0 else (-4 if u[2] > 0 else 5))
    n = (2147483647 if u[2] > 0 else -2147483647) * (3 if u[0] > 0 else 4)
    y[3] = n // (7 if u[1] > 0 else -7) + (5 if u[2] > 0 else k)


def countdown(n):
    total = 0.0
    while n > -3:
        total = total * 2.0 + TABLE[n % 3]
        n = n - 1
    return total


def arguments(u, y, k):
    """An argument that becomes another number of its kind, negative at last."""
    y[0], y[1] = countdown(4), countdown(k)
    y[2], y[3] = 0.0, 0.0


KERNELS = [numbers, operations, loops, order, rows, aliases, call_order, hidden_names, truth, choices, arguments]


@pytest.mark.sampled(6)
@pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.__name__)
def test_the_bits_of_python(kernel, compiled, same_bits):
    rng = np.random.default_rng(1)
    plain, c = Written(kernel).online(0.1, compiled=False), compiled(Written(kernel), dt=0.1, name=kernel.__name__)
    for _ in range(60):
        u = rng.normal(size=3).round(rng.integers(0, 3))
        with np.errstate(all="ignore"):
            expected = plain(u=u).y
        same_bits(c(u=u)["y"], expected)


def test_rates_time_and_what_comes_from_outside(tmp_path, compiled):
    """Three blocks of a diagram as one, two of them at their own rates, beside a run of the whole."""
    diagram = cosim.Diagram("1/50")
    wave = diagram.add(cosim.Sine(amplitude=2.0, period=0.7), name="wave", every=2)
    noise = diagram.add(cosim.Gaussian(std=0.5), name="noise")
    total = diagram.add(cosim.Sum("+-"), name="total", every=4)
    delay = diagram.add(cosim.UnitDelay(), name="delay", every=2)
    gain = diagram.add(cosim.Gain(3.0), name="gain", every=2)
    diagram.connect(wave["y"], total["u"][0])
    diagram.connect(noise["y"], total["u"][1])
    diagram.connect(total["y"], delay["u"])
    diagram.connect(delay["y"], gain["u"])
    run = diagram.simulate(3.0, seed=4, record=["*"], engine="interpreted")
    part = compiled(diagram, blocks=["total", "gain", "wave", "delay"], name="part", inputs={"total.u[1]": "seen"})
    assert part.program.step * 25 == 1
    assert [signal.name for signal in part.program.inputs] == ["seen"]
    for k in range(75):
        out = part(seen=run["noise.y"][2 * k])
        for name, value in out.items():
            assert value == run[name][2 * k], (name, k)


REFUSED = {
    "array": (lambda: block_of(adds_array), "uses an array, a tuple or a function where a number is needed"),
    "slice": (lambda: block_of(takes_slice), "uses a slice; write a loop over its elements"),
    "value of and": (lambda: block_of(chooses_by_and), "uses a number in 'and' or 'or'; use ops.select"),
    "loop over array": (
        lambda: block_of(loops_over_array),
        "loops over something other than a range; write for i in range",
    ),
    "two kinds": (lambda: block_of(two_kinds), "assigns values of different kinds to 'a'; use two names"),
    "float index": (
        lambda: block_of(float_index),
        "uses a number that is not whole as an index or count (y[u[0]]); use whole numbers. For a place that is a float, write a "
        "loop: for k in range(n): x[k] = ops.select(k == place, new, x[k])",
    ),
    "out of range": (lambda: block_of(out_of_range), "uses element 4 of 4 (y[4]); the last one is 3"),
    "row": (lambda: block_of(stores_row), "assigns to a whole row or a tuple"),
    "lambda": (lambda: block_of(lambda u, y: None), "Define it with def"),
    "callback": (lambda: cosim.StateSpace(NONLINEAR), "calls Python, which is not available in the exported C"),
    "target": (lambda: block_of(calls_to_store), "calls a function in the target of an assignment (y[place(u)])"),
    "chain": (lambda: block_of(calls_in_chain), "calls a function after a second comparison"),
    "mask": (lambda: block_of(masks), "uses a truth value as an index (u[u[0] > 0.0])"),
    "truth": (lambda: block_of(adds_truth), "calculates with two truth values, which NumPy does not treat as numbers"),
    "huge": (lambda: block_of(is_huge), "uses the whole number 9223372036854775808, which does not fit 64 bits"),
    "twice": (lambda: block_of(names_twice), "calls 'returned' with wrong arguments; its arguments are a, b"),
    "remainder": (lambda: block_of(float_remainder), "uses // or % with numbers that are not whole; use ops.floor"),
}


def block_of(kernel):
    return Written(kernel)


def adds_array(u, y):
    y[0] = u + 1.0


def takes_slice(u, y):
    y[0] = u[0:2][0]


def chooses_by_and(u, y):
    y[0] = u[0] and u[1]


def loops_over_array(u, y):
    for value in u:
        y[0] = value


def two_kinds(u, y):
    a = u
    a = 1.0
    y[0] = a


def float_index(u, y):
    y[0] = y[u[0]]


def out_of_range(u, y):
    y[4] = u[0]


def stores_row(u, y, X):
    X[0] = u[0]


def place(u):
    return 1


def calls_to_store(u, y):
    y[place(u)] = u[0]


def calls_in_chain(u, y):
    y[0] = 1.0 if 0.0 < u[0] < largest(u) else 0.0


def masks(u, y):
    y[0] = u[u[0] > 0.0]


def adds_truth(u, y):
    y[0] = (u[0] > 0.0) + (u[1] > 0.0)


def is_huge(u, y):
    y[0] = u[0] * 9223372036854775808


def names_twice(u, y):
    y[0], y[1] = returned(u[0], 1.0, a=u[1])


def float_remainder(u, y):
    y[0] = u[0] % 2.0


NONLINEAR = control.nlsys(lambda t, x, u, p: [x[0] + u[0]], lambda t, x, u, p: x, inputs=1, outputs=1, states=1, dt=0.1)


@pytest.mark.parametrize("case", REFUSED)
def test_what_has_no_c_is_told_with_its_line(case):
    make, sentence = REFUSED[case]
    block = make()
    with pytest.raises(cosim.BayesFTCError, match=re.escape(sentence)) as caught:
        write_c(program_of(block, dt=0.1))
    if isinstance(block, Written) and case != "lambda":
        first = block.kernel.__code__.co_firstlineno
        line = int(re.search(r"\(test_language\.py, line (\d+)\)", str(caught.value))[1])
        assert first < line <= first + 3


def test_an_edited_file_is_noticed(tmp_path, monkeypatch):
    file = tmp_path / "edited.py"
    file.write_text("def step(u, y):\n    y[0] = u[0] + 1.0\n")
    monkeypatch.syspath_prepend(tmp_path)
    import edited

    block = Written(edited.step)
    file.write_text("def step(u, y):\n    y[0] = u[0] + 2.0\n")
    linecache.checkcache()
    with pytest.raises(cosim.KernelError, match="has changed since it was loaded"):
        write_c(program_of(block, dt=0.1))


def test_names_of_c_are_left_to_c(compiled):
    c = compiled(Written(with_names_of_c), dt=0.1, name="double")
    np.testing.assert_array_equal(c(u=[1.0, 2.0, 3.0])["y"], [3.0, 7.0, 5.0, 1.0])


def exponent(register):
    return register + 1.0


def with_names_of_c(u, y):
    double = u[1]
    exponent_ = exponent(double)
    größe, NAN, y0 = u[0] + 4.0 + u[1], exponent_, u[0]
    y[0], y[1], y[2], y[3] = NAN, größe, u[2] + double, y0


"""All words that C or its library have taken, or that are not ASCII."""


def with_a_comment_that_names_a_function(u, y):
    unread = 1.0 + ops.cos(u[1])  # noqa: F841
    y[0] = square(u[0])


def test_a_function_that_only_a_comment_names_is_left_out():
    """The digits of a cosine that nobody reads are found by "product", a word of the comment on a square."""
    source = write_c(program_of(Written(with_a_comment_that_names_a_function), dt=0.1)).source
    assert "Return the product of" in source
    assert re.findall(r"static double (\w+)\(", source) == ["square"]
