"""Random step functions of all that the language has: the same bits as plain Python, compiled by numba, as C, and in lanes."""

import importlib.util
import random

import numpy as np
import pytest
from hypothesis import Phase, given, settings, strategies as st
from in_lanes import stepped_in_lanes

from bayesftc import cosim
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.export.program import program_of

SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 3.0, 1e308, -1e308, 5e-324, -1e-310, np.inf, -np.inf, np.nan]
BEGIN = '''\
from bayesftc.cosim import ops
from bayesftc.cosim.ops import absolute, both, either, floor, isnan, maximum, minimum, negate, select, sqrt, square

TABLE, WEIGHTS, FLAGS = (2, 0, 1, 5), (0.5, -0.0, 1e300, 3.0), (True, False, True, True)
GAIN, HUGE, ZERO = -1.5, 9007199254740993, -0.0


def put(x, i, by=0.5, times=2):
    """Change an element /* and return it. */"""
    x[i] = x[i] * times + by
    return x[i]


def pair(a, b):
    return a - b, b * 2


def through(a, b):
    return pair(b, a)


def silent(x, n):
    n = n - 1
    if n < 0:
        return
    x[n] = x[n] + 1.0


def first_above(x, limit):
    for i in range(x.shape[0]):
        if x[i] > limit:
            return i
    return -1


def blend(a, b, X):
    X[0, 1] = a[0] + b[1]
    b[0] = a[2] - X[0, 1]
    return 1 if a[0] > b[0] else b[2]


def ending(a, n):
    for i in range(n, -n - 1, -3):
        for j in range(i, n, 2):
            while True:
                n = n - 1
                if n < -2 or a > n:
                    return n
                elif n == 3:
                    continue
                if j == i:
                    break
            a = a * 0.5 - j
            if a < -9.0:
                return i
    return -i - 7


def large(a):
    return a > 0.5 or isnan(a)


def applied(f, a):
    return f(a)


def three(a, n):
    if a > n:
        return a, n, a > n
    return a - 1, -n, True
'''


class Writer:
    """Writes a step function of some statements, by the numbers that it is given."""

    def __init__(self, seeded, name, keywords):
        self.keywords = keywords  # numba does not take them in calls of other step functions
        self.random, self.lines, self.depth, self.loops, self.count = seeded, [], 1, [], 0
        self.fresh = []  # names that are assigned once, of blocks that are open
        self.lines.append(f"def {name}(u, y, x, X, k):")
        # Names of C, and such that differ only by what makes them names of C.
        self.floats = ["a", "double", "double_", "put_1", "t_1"]
        self.wholes = ["n", "int", "op_"]
        self.flags = ["flag"]
        self.emit("a, double, double_, put_1, t_1 = u[0], 0.0, u[1], -0.0, x[0]")
        self.emit("n, int, op_, mixed, flag = 1, k % 3, -2, 3, u[0] > 0")
        self.emit("row, other, i = X[0], X[1], 0")
        self.block(seeded.randint(4, 8), 0)
        self.emit("y[0], y[1], y[2] = a + double, double_ * put_1, n + int * 0.5 + mixed")
        self.emit("y[3] = t_1 + row[0] + other[1] + op_ + i + (1.0 if flag else 0)")

    def emit(self, line):
        self.lines.append("    " * self.depth + line)

    def of(self, *choices):
        return self.random.choice(choices)

    def named(self, text):
        return text if self.keywords else text.replace("a=", "").replace("b=", "")

    def element(self):
        place = self.random.randint(0, 5)
        if place == 0:
            return f"X[{self.of('0', '1', '-1', 'k % 2')}, {self.of('0', '2', '-3', f'({self.whole(1)}) % 3')}]"
        if place == 1:
            return f"{self.of('row', 'other', 'X[1]')}[{self.of('0', '1', '-1')}]"
        return f"{self.of('u', 'x')}[{self.of('0', '1', '2', '-1', '-3', f'({self.whole(1)}) % 3', 'TABLE[k % 3]')}]"

    def number(self, depth):
        """Return an expression of a float."""
        kind = self.random.randint(0, 14) if depth else self.random.randint(0, 2)
        if kind == 0:
            return self.element()
        if kind <= 2:
            return self.of(*self.floats, *self.fresh, self.element(), "0.25", "-1e-3", "GAIN", "ZERO", "-ZERO")
        if kind == 3:
            return f"({self.number(depth - 1)}) {self.of('+', '-', '*')} ({self.whole(depth - 1)})"
        if kind == 4:
            return f"({self.whole(depth - 1)}) {self.of('+', '-', '*', '/')} {self.element()}"
        if kind == 5:
            return f"{self.of('-', '+')}({self.number(depth - 1)})"
        if kind == 6:
            return f"({self.number(1)} if {self.test(depth - 1)} else {self.of(self.number(1), '2.0', '3')})"
        if kind == 7:
            called = self.of("sqrt", "floor", "absolute", "square", "ops.sin", "ops.cos", "ops.log", "ops.exp")
            return f"{called}({self.of(self.number(depth - 1), self.element(), '4')})"
        if kind == 8:
            called = self.of(
                "minimum({}, {})",
                self.named("maximum({}, b={})"),
                "select(u[1] > 0, {}, {})",
                self.named("select(mixed, b={}, a={})"),
            )
            return called.format(self.number(depth - 1), self.of(self.number(depth - 1), "1", self.whole(0)))
        if kind == 9:
            return f"{self.element()} * mixed"
        if kind == 10:
            return f"WEIGHTS[({self.whole(depth - 1)}) % 4] * {self.element()}"
        if kind == 11:
            return f"{self.element()} {self.of('*', '/', '+', '-')} {self.element()} {self.of('*', '/', '-')} {self.element()}"
        if kind == 14 and depth > 1:
            quotient = f"(t_1 - {self.of('0.25', 'n')}) / {self.of('3', '-7', '(k + 2)')}"
            return f"{quotient} - applied({self.of('sqrt', 'large')}, u[0]) * 2"
        if kind == 12 and depth > 1:
            return self.of(
                "put(x, 1)", *(["put(x, i=2, by=u[0])", "put(by=x[0], x=row, i=1)"] if self.keywords else [])
            )
        return f"({self.number(depth - 1)}) {self.of('+', '-', '*')} ({self.number(depth - 1)})"

    def whole(self, depth):
        """Return an expression of a whole number."""
        kind = self.random.randint(0, 11) if depth else 0
        if kind <= 1:
            return self.of(*self.wholes, *self.loops, "k", "2", "-3", "x.shape[0]", "len(X)", "(k > 2) * 2", "True * n")
        if kind == 2:
            return f"({self.whole(depth - 1)}) {self.of('//', '%')} {self.of('3', '-2', '5', '(k + 1)')}"
        if kind == 3:
            return f"-({self.whole(depth - 1)} * 1)"
        if kind == 4:
            return f"TABLE[({self.whole(depth - 1)}) % 4]"
        if kind == 5:
            return f"({self.test(depth - 1)}) * {self.of('3', '2147483647', 'n')} + {self.of('1', 'FLAGS[k % 4]', '(u[0] > 0)')}"
        if kind == 6:
            literals = self.of("3", "2147483647"), self.of("-2", "-2147483647", "2147483646")
            return f"({literals[0]} if {self.test(depth - 1)} else {literals[1]}) + {self.of('7', '-7')}"
        if kind == 7:
            return f"({self.whole(depth - 1)}) // {self.of('(-3 if k % 2 else 4)', '(2 if flag else -5)', '-7')}"
        if kind == 8 and depth > 1:
            # A whole number that is chosen while translating would make `a` one, and `ending` makes it a fraction.
            return f"ending(({self.number(1)}) * 1.0, ({self.whole(1)}) % 5)"
        return f"({self.whole(depth - 1)}) {self.of('+', '-', '*')} ({self.whole(depth - 1)}) % 7"

    def test(self, depth):
        """Return a condition."""
        kind = self.random.randint(0, 8) if depth else 0
        sides = [self.number(0), self.whole(0), self.number(0)]
        signs = [self.of("<", "<=", ">", ">=", "==", "!=") for _ in range(2)]
        if kind <= 1:
            return f"{sides[0]} {signs[0]} {sides[self.of(1, 2)]}"
        if kind == 2:
            return f"{sides[0]} {signs[0]} {sides[1]} {signs[1]} {sides[2]}"
        if kind == 3:
            return f"({self.test(depth - 1)}) {self.of('and', 'or')} {self.of(self.test(depth - 1), 'flag')}"
        if kind == 4:
            return f"not ({self.test(depth - 1)})"
        if kind == 5:
            return self.of("both({}, {})", self.named("either(a={}, b={})")).format(
                self.test(0), self.of("flag", self.test(0))
            )
        if kind == 6:
            return f"negate({self.of(self.test(0), self.element())})"
        return self.of("flag", f"isnan({self.element()})", "FLAGS[1]", f"{sides[0]} > 0")

    def block(self, size, depth):
        begun = len(self.fresh)
        for _ in range(size):
            self.statement(depth)
        del self.fresh[begun:]

    def inner(self, head, depth, *first):
        self.emit(head)
        self.depth += 1
        for line in first:
            self.emit(line)
        self.block(self.random.randint(1, 3), depth + 1)
        self.depth -= 1

    def statement(self, depth):
        kind = self.random.randint(0, 20 if depth < 3 else 13)
        self.count += 1
        if kind <= 1:
            self.emit(f"{self.of(*self.floats)} = {self.number(3)}")
        elif kind == 2:
            self.emit(f"{self.of(*self.floats)} {self.of('+=', '-=', '*=')} {self.number(2)}")
        elif kind == 3:
            name = self.of("w_{}", "t_{}", "row_{}", "größe{}").format(self.count)
            self.emit(f"{name} = {self.number(3)}")
            self.fresh.append(name)
        elif kind == 4:
            self.emit(f"{self.of(*self.wholes)} = {self.of(self.whole(2), '5')} % 1000")
        elif kind == 5:
            self.emit(f"{self.of('x[0]', 'x[-1]', 'x[n % 3]', 'X[1, 2]', 'X[k % 2][1]', 'row[2]')} = {self.number(3)}")
        elif kind == 6:
            self.emit(f"{self.of('x[1]', 'x[n % 3]', 'row[0]', 'X[1, n % 3]')} {self.of('+=', '*=')} {self.number(2)}")
        elif kind == 7:
            self.emit(
                self.of("row, other = other, row", "x[0], x[2] = x[2], x[0]", "n, x[n % 3] = 2, a", "a, t_1 = t_1, a")
            )
        elif kind == 8:
            self.emit(self.of("n, row = 1 - n % 2, X[n % 2]", "a = x[1] = double + 1.0", "row = other = X[k % 2]"))
        elif kind == 9:
            arguments = self.named(f"({self.number(2)}, b={self.number(1)})")
            self.emit(f"{self.of('a, double', 'x[0], t_1')} = {self.of('pair', 'through')}{arguments}")
        elif kind == 10:
            self.emit(
                self.of("put(x, n % 3)", "silent(row, n % 4 - 1)", "n = first_above(x, a) + 1", "flag = put(x, 0) > a")
            )
        elif kind == 11:
            self.emit(f"double = blend({self.of('x', 'row')}, {self.of('x', 'other', 'X[0]')}, X) * {self.element()}")
        elif kind == 12:
            self.emit(f"flag = {self.test(2)}")
        elif kind == 13:
            self.emit(
                self.of(
                    f"mixed = {self.of('2', 'k % 2 + 1', self.element())}",
                    f"a, n, flag = three({self.number(1)}, ({self.whole(1)}) % 50)",
                )
            )
        elif kind <= 15:
            self.inner(f"if {self.of(self.test(2), 'put(x, 1) < a')}:", depth)
            if self.of(True, False):
                self.inner(f"elif {self.test(1)}:", depth)
            if self.of(True, False):
                self.inner("else:", depth)
        elif kind <= 18:
            name, bounds = (
                f"j{self.count}",
                self.of("3", "n % 4", "2, -1, -1", "k % 3, 4", "-2, 2, 2", "n, n + 1", "1", "int"),
            )
            if bounds == "int":
                bounds = "int % 3"
            name = self.of(name, name, "i")
            self.loops.append(name)
            jump = [f"if {self.test(1)}:", f"    {self.of('break', 'continue')}"] if self.of(True, False) else []
            self.inner(f"for {name} in range({bounds}):", depth, *jump, *(["n = 2"] if self.of(True, False) else []))
            self.loops.remove(name)
        else:
            name = f"left{self.count}"
            self.emit(f"{name} = {self.of('3', 'k % 4')}")
            self.inner(f"while {name} > 0{self.of('', ' and not flag')}:", depth, f"{name} -= 1")


class Random(cosim.Block):
    inputs = (cosim.Port("u", (3,)),)
    outputs = (cosim.Port("y", (4,)),)

    def __init__(self, kernel):
        self.kernel = kernel

    def define(self, step):
        return cosim.Definition(self.kernel, state={"x": [1.0, -2.0, 0.5], "X": [[1.0, 2.0, -0.0], [3.0, 4.0, 7.0]]})


def trajectory(step, values):
    with np.errstate(all="ignore"):
        return np.array([step(u) for u in values])


def check(seeded, folder, compiled_together, same_bits, *, functions, by_numba):
    names = [f"step_{i}" for i in range(functions)]
    text = "\n\n".join(
        [BEGIN, *("\n".join(Writer(seeded, name, keywords=i >= by_numba).lines) + "\n" for i, name in enumerate(names))]
    )
    (folder / "written.py").write_text(text)
    spec = importlib.util.spec_from_file_location("written", folder / "written.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    values = np.random.default_rng(0).choice([*SPECIAL, 0.3, -0.7, 1.9], (25, 3))
    values[::2] = np.random.default_rng(1).normal(size=values[::2].shape)
    expected, blocks = {}, {name: Random(getattr(module, name)) for name in names}
    for name, block in blocks.items():
        online = block.online(0.1, compiled=False)
        expected[name] = trajectory(lambda u, online=online: online(u=u).y, values)
    compiled = compiled_together(folder, [program_of(block, dt=0.1, name=name) for name, block in blocks.items()])
    for i, ((name, block), c) in enumerate(zip(blocks.items(), compiled, strict=True)):
        same_bits(trajectory(lambda u, c=c: c(u=u)["y"], values), expected[name], name)
        if i < by_numba:
            online = block.online(0.1, compiled=True)
            same_bits(trajectory(lambda u, online=online: online(u=u).y, values), expected[name], f"{name} by numba")
    refused = sum(not check_lanes(block, values, expected[name], same_bits, name) for name, block in blocks.items())
    assert refused < len(blocks)


def check_lanes(block, values, expected, same_bits, name):
    """Compare four lanes, of which each gets other inputs; return False if a whole array is chosen by numbers of a lane."""
    others = [np.roll(values, shift, axis=0) for shift in (7, 0, 13, 2)]
    try:
        found = stepped_in_lanes(block, 0.1, np.stack(others, axis=1))
    except KernelError as refused:
        if "Whole arrays are chosen" in str(refused):
            return False
        raise
    for lane, inputs in enumerate(others):
        online = block.online(0.1, compiled=False)
        alone = expected if lane == 1 else trajectory(lambda u, online=online: online(u=u).y, inputs)
        same_bits(found[:, lane], alone, f"{name} in lane {lane}")
    return True


@pytest.mark.parametrize(
    ("examples", "functions", "by_numba"), [(1, 6, 1), pytest.param(60, 40, 4, marks=pytest.mark.slow)]
)
def test_random_step_functions(tmp_path_factory, compiled_together, same_bits, examples, functions, by_numba):
    """A seed for each example: functions as long as these have more choices than Hypothesis draws, or would shrink in time."""

    @settings(max_examples=examples, deadline=None, derandomize=True, database=None, phases=[Phase.generate])
    @given(st.integers(0, 2**32).map(random.Random))
    def run(seeded):
        check(
            seeded,
            tmp_path_factory.mktemp("random"),
            compiled_together,
            same_bits,
            functions=functions,
            by_numba=by_numba,
        )

    run()
