"""What may be compiled, and that compiled code is reused exactly as long as it is the same code."""

import gc
import importlib.util
import json
import math
import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np
import pytest

from bayesftc import cosim, fmus
from bayesftc.cosim import Port, ops
from bayesftc.cosim.base.cache import cache_directory
from bayesftc.cosim.errors import KernelError
from bayesftc.cosim.ops import both, exp, select, sqrt, square
from bayesftc.cosim.stepping import compiler as _compiler
from bayesftc.cosim.stepping.fingerprint import fingerprint, service_fingerprint
from bayesftc.cosim.stepping.kept import STATISTICS
from bayesftc.cosim.stepping.machine import steps as _steps

# --- the contract ---------------------------------------------------------------------------------------------------------------

UNSUITABLE = {"a": 1}
FUNCTIONS = (sqrt, exp)


def uses_numpy(y):
    y[0] = np.sin(y[0])


def uses_math(y):
    y[0] = math.exp(y[0])


def uses_power(y):
    y[0] = y[0] ** 2


def uses_power_in_place(y):
    y[0] **= 2


def uses_product(y):
    y[0] = y @ y


def uses_unknown(y):
    y[0] = nowhere(y[0])  # noqa: F821


def uses_abs(y):
    y[0] = abs(y[0])


def uses_method(y):
    y[0] = y.sum()


def uses_dictionary(y):
    y[0] = UNSUITABLE["a"]


def recursive(y):
    recursive(y)


def first(y):
    second(y)


def second(y):
    first(y)


def uses_a_helper_with_math(y):
    uses_math(y)


def imports(y):
    import math

    y[0] = math.sin(y[0])


def comprehends(y):
    y[0] = sum_up([y[i] for i in range(1)])


def sum_up(x):
    return x[0]


def writes_global(y):
    global UNSUITABLE
    UNSUITABLE = 1.0
    y[0] = 1.0


def helper_with_default(y, shape=math):
    y[0] = 1.0


def calls_default(y):
    helper_with_default(y)


def make_unfilled():
    def unfilled(y):
        y[0] = late

    if False:
        late = 1.0
    return unfilled


def changes_type(y):
    x = 1.0
    if y[0] > 0:
        x = y
    y[0] = x


REFUSED = {
    uses_numpy: r"'uses_numpy' \(test_compiler_cache.py, line \d+\) uses 'np' \(the module numpy\)\. A step function may use",
    uses_math: r"'uses_math' .* uses 'math' \(the module math\)",
    uses_power: r"'uses_power' .* uses '\*\*', which rounds differently",
    uses_power_in_place: r"uses '\*\*', which rounds differently",
    uses_product: r"uses '@', which allocates",
    uses_unknown: r"'uses_unknown' .* uses 'nowhere', which is not defined",
    uses_abs: r"uses 'abs' \(a builtin_function_or_method\).*absolute",
    uses_method: r"uses the attribute 'sum'. A step function may use only shape",
    uses_dictionary: r"uses 'UNSUITABLE' \(a dict\)",
    recursive: r"calls itself \(recursive -> recursive\)",
    first: r"calls itself \(first -> second -> first\)",
    uses_a_helper_with_math: r"'uses_math' .* uses 'math'",
    imports: r"'imports' .* contains an import; import from bayesftc.cosim.ops at the top",
    comprehends: r"contains a function or comprehension|creates a list|uses 'sum_up'|cannot be compiled",
    writes_global: r"writes a global variable; declare a state",
    calls_default: r"'helper_with_default' .* (has a default that is no number|uses)",
    make_unfilled(): r"uses 'late', which has no value yet",
    changes_type: r"'changes_type' .*line \d+\) assigns values of different kinds to 'x'; use two names",
}


@pytest.mark.parametrize("kernel", REFUSED, ids=lambda f: f.__name__)
def test_refused(kernel, make_block):
    block = make_block(outputs=[Port("y")], output=kernel)
    diagram = cosim.Diagram(1)
    diagram.add(block)
    for run in (lambda: diagram.simulate(0, engine="compiled"), lambda: block.online(1)):
        with pytest.raises(cosim.KernelError, match=REFUSED[kernel]):
            run()


def tells_a_root(y):
    y[0] = 1.0
    y[0] = math.sqrt(y[0])  # this line


def limits(y):
    y[0] = max(y[0], 0.0)  # this line


def finds_a_place(y):
    y[0] = 1.0
    y[int(y[0]) - 1] = 2.0  # this line


def looks_up(y):
    for i in range(2):
        y[0] = UNSUITABLE[i]  # this line


def draws(y):
    y[0] = np.random.random()  # this line  # noqa: NPY002


def catches(y):
    try:
        y[0] = 1.0 / y[0]
    except ZeroDivisionError:  # this line
        y[0] = 0.0


def squares(y):
    y[0] = (
        y[0] ** 2  # this line
    )


def calls_squares(y):
    squares(y)


INSTEAD = {
    tells_a_root: "Instead of math.sqrt use ops.sqrt.",
    limits: "Instead of max use ops.maximum.",
    finds_a_place: "ops.floor, which gives a float. For an index, write a loop: for k in range(n): x[k] = ops.select(k == place",
    looks_up: "as a parameter of the block.",
    draws: 'Port("noise", draw="normal").',
    catches: "use ops.select",
    squares: "ops.square",
    calls_squares: "ops.square",
}


@pytest.mark.parametrize("kernel", INSTEAD, ids=lambda f: f.__name__)
def test_a_refusal_names_the_line_and_what_to_write_instead(kernel, make_block):
    block = make_block(outputs=[Port("y")], output=kernel)
    with pytest.raises(cosim.KernelError) as refused:
        block.online(1)
    said = str(refused.value)
    line = int(re.search(r"line (\d+)\)", said)[1])
    assert "# this line" in Path(__file__).read_text().splitlines()[line - 1]
    assert INSTEAD[kernel] in said


def allowed_kernel(y, a):
    total = 0.0
    for i in range(len(a)):
        total = total + select(both(a[i] > 0.0, i < a.size), ops.sqrt(a[i]), square(a[i]))
    y[0] = total / (a.shape[0] - 3) if a.ndim == 1 else FUNCTIONS[0](total)


def test_allowed(make_block):
    block = make_block(outputs=[Port("y")], output=allowed_kernel, parameters={"a": [4.0, -3.0, 0.25]})
    assert block.online(1)().y == block.online(1, compiled=False)().y == math.inf  # 11.5 / 0


# --- reuse ----------------------------------------------------------------------------------------------------------------------

MODULE = """
from bayesftc.cosim.ops import sqrt
{helper_import}
FACTOR = {factor}

def helper(x):
    return {body}

def make(scale):
    def kernel(y):
        y[0] = scale * helper({argument}) + FACTOR
    return kernel
"""
PLAIN = {"helper_import": "", "factor": "0.5", "body": "x + 1.0", "argument": "2.0"}


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Write a module, import it anew, and return it."""
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(_compiler, "_modules", {})  # as in a process of its own
    monkeypatch.setattr(_steps, "_addresses", {})
    monkeypatch.setattr(_steps, "_kernels", WeakKeyDictionary())

    def load(text=MODULE, **changes):
        for key, value in {**PLAIN, **changes}.items():
            text = text.replace("{" + key + "}", value)
        path = tmp_path / "written.py"
        path.write_text(text)
        spec = importlib.util.spec_from_loader("written", loader=None)
        fresh = importlib.util.module_from_spec(spec)
        exec(compile(text, str(path), "exec"), fresh.__dict__)
        return fresh

    return load


@pytest.fixture
def evaluate(make_block):
    """Return a kernel's y and how many functions were compiled for it."""

    def run(kernel):
        before = dict(STATISTICS)
        y = make_block(outputs=[Port("y")], output=kernel).online(1)().y
        return y, STATISTICS["compiled"] - before["compiled"]

    return run


def test_comments_and_moved_lines_compile_nothing(module, evaluate):
    assert evaluate(module().make(3.0)) == (9.5, 1)
    assert evaluate(module().make(3.0)) == (9.5, 0)
    moved = "# a comment\n\n\n" + MODULE.replace("    return {body}", "    # why\n\n    return (  {body}  )  # so")
    assert evaluate(module(moved).make(3.0)) == (9.5, 0)


@pytest.mark.parametrize(
    ("changes", "scale", "y"),
    [({"body": "x + 1.5"}, 3.0, 11.0), ({"factor": "0.25"}, 3.0, 9.25), ({}, 4.0, 12.5), ({"argument": "3.0"}, 3.0, 12.5),
     ({"body": "sqrt(x)"}, 3.0, 3 * math.sqrt(2) + 0.5), ({"factor": "1"}, 3.0, 10.0)],
)  # fmt: skip
def test_edits_are_noticed(module, evaluate, changes, scale, y):
    evaluate(module().make(3.0))
    assert evaluate(module(**changes).make(scale)) == (y, 1)
    assert evaluate(module().make(3.0)) == (9.5, 0)


def test_a_changed_global_is_noticed_in_the_same_function(module, evaluate):
    written = module()
    kernel = written.make(3.0)
    assert evaluate(kernel) == (9.5, 1)
    written.FACTOR = 100.0
    assert evaluate(kernel) == (109.0, 1)
    written.helper = module(body="x").helper
    assert evaluate(kernel) == (106.0, 1)
    written.FACTOR = 0.5
    assert evaluate(kernel) == (6.5, 1)
    assert evaluate(kernel) == (6.5, 0)


WITHOUT_TEXT = """
def helper(x):
    return 3.0 * x

def one(y):
    y[0] = helper(2.0)

def two(y):
    y[0] = helper(3.0)

def wrong(y):
    y[0] = y[0, 0]
"""


def test_functions_without_a_text_are_compiled_by_numba_and_what_they_call_once(module, evaluate):
    written, shared = {}, []
    exec(WITHOUT_TEXT, written)  # as in Python's own prompt
    for name, y in (("one", 6.0), ("two", 9.0)):
        assert evaluate(written[name]) == (y, 1)
        shared.append(_compiler._latest_twin[written["helper"]])
    assert shared[0] is shared[1]
    with pytest.raises(KernelError, match=r"'wrong' .* cannot be compiled: .*Write plain loops over float64 numbers"):
        evaluate(written["wrong"])


def takes_a_slice(y):
    for value in y[:1]:
        y[0] = 2.0 + 0.0 * (value == value)


def test_what_c_is_not_written_for_is_compiled_by_numba(evaluate):
    with pytest.raises(KernelError, match="loops over something other than a range"):
        _steps.text_of(takes_a_slice, {"y": ("outputs", 0, (1,))}, "entry")
    assert evaluate(takes_a_slice)[0] == 2.0


@pytest.mark.parametrize("on", [True, False])
def test_compiling_leaves_the_garbage_collector_as_it_was(module, evaluate, on):
    def refused(y):
        y[0] = y[0, 0]

    try:
        gc.enable() if on else gc.disable()
        assert evaluate(module().make(3.0)) == (9.5, 1)
        assert gc.isenabled() == on
        with pytest.raises(KernelError):
            evaluate(refused)
        assert gc.isenabled() == on
    finally:
        gc.enable()


OTHER_NUMBA = """
import json
import sys
import warnings
import numba
if sys.argv[1] == "unknown":
    numba.version_info = numba.version_info._replace(short=(99, 0))
if sys.argv[1] == "other inside":
    del numba._dynfunc
    sys.modules["numba._dynfunc"] = None
warnings.simplefilter("always")
from bayesftc import cosim, fmus
from bayesftc.cosim.stepping.machine import shipped

shipped.sources_digest = lambda: "of other sources, so that numba translates them"

loop = cosim.Diagram(dt=0.02)
car, sensors = loop.add(cosim.FMU(fmus.path("CruiseControl")), "car"), loop.add(cosim.Sensors(count=2, std=1.0), "sensors")
sine, apart = loop.add(cosim.Sine(amplitude=5.0, period=8.0)), loop.add(cosim.Sum("+-"))
gain, limit = loop.add(cosim.Gain(800.0)), loop.add(cosim.Saturation(-1e3, 1e3))
for source, target in (
    (car["v"], sensors["u"]), ([sine["y"], sensors["y"][0]], apart["u"]), (apart["y"], gain["u"]), (gain["y"], limit["u"]),
    (limit["y"], car["force"]),
):
    loop.connect(source, target)
with warnings.catch_warnings(record=True) as caught:
    result = loop.simulate(10.0, seed=1, engine="compiled")
from bayesftc.cosim.stepping import numba_ops as _numba_ops

told = [(str(warning.message), warning.filename) for warning in caught if "compiles step functions" in str(warning.message)]
print(json.dumps(["pipeline_class" in _numba_ops.OPTIONS, told, {name: result[name].tobytes().hex() for name in result}]))
"""

ONE_FUNCTION = """
def takes_a_slice(y):
    for value in y[:1]:
        y[0] = 2.0 + 0.0 * (value == value)

class Two(cosim.Block):
    inputs, outputs = (), (cosim.Port("y"),)
    def define(self, step):
        return cosim.Definition(output=takes_a_slice)

loop = cosim.Diagram(0.1)
loop.add(Two(), "two")
"""
"""A run for which numba compiles one function: C is not written for its loop."""


OTHERS = [
    pytest.param("unknown", r"it is newer than numba 0\.68, the newest that this bayesftc supports", id="unknown"),
    pytest.param("other inside", r"its private parts have changed \(.*_dynfunc.*\)", id="other inside"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("other", "reason"), OTHERS)
def test_a_numba_that_is_not_known_compiles_to_the_same_bits_and_says_so(python, tmp_path, other, reason):
    (ours, silent, known), (plain, told, unknown) = (
        python(OTHER_NUMBA, version, cache=tmp_path / version, timeout=300) for version in ("known", other)
    )
    assert (ours, plain, silent) == (True, False, [])
    assert known == unknown
    ((text, file),) = told
    assert re.fullmatch(
        rf"numba \S+ compiles step functions without this package's pipeline, as {reason}\. .* 'numba<0\.69'\.", text
    )
    assert file == "<string>"


@pytest.mark.slow
@pytest.mark.parametrize(("other", "reason"), OTHERS)
def test_a_numba_that_is_not_known_is_told_at_once(python, tmp_path, other, reason):
    begin, end = OTHER_NUMBA.index("\nshipped.sources"), OTHER_NUMBA.index("\nwith warnings")
    plain, told, values = python(OTHER_NUMBA[:begin] + ONE_FUNCTION + OTHER_NUMBA[end:], other, cache=tmp_path)
    assert not plain
    assert len(told) == 1
    assert re.search(reason, told[0][0])
    assert told[0][1] == "<string>"
    assert len(values) == 1


def test_functions_of_one_name_are_told_apart(evaluate):
    # Both helpers are called h, and both are reached by way of g first, in whichever order they are then given.
    def make_h(a):
        def h(x):
            return x + a

        return h

    one, two = make_h(1.0), make_h(10.0)

    def g(x):
        return one(x) + two(x)

    def make(left, right):
        def kernel(y):
            y[0] = 0.0 * g(1.0) + left(1.0) * 2.0 + right(1.0)

        return kernel

    assert evaluate(make(one, two))[0] == 15.0
    assert evaluate(make(two, one))[0] == 24.0
    assert evaluate(make(two, two))[0] == 33.0
    assert fingerprint(make(one, two), "") == fingerprint(make(one, two), "")


SERVICE = """
from numba.extending import intrinsic, register_jitable
RATE = {rate}

@intrinsic
def native(context, x):
    def codegen(context, builder, signature, args):
        return {native}
    return x(x), codegen

@register_jitable
def helper(x):
    return {helper}

def service(x):
    return native(helper(x)) + RATE
"""


def test_the_engines_own_functions_are_known_by_the_code_that_is_loaded(module):
    plain = {"rate": "1.0", "native": "args[0]", "helper": "x"}

    def print_of(text=SERVICE, **changes):
        return service_fingerprint(module(text, **{**plain, **changes}).service, "")

    loaded = module(SERVICE, **plain).service
    edited = [print_of(), print_of(rate="2.0"), print_of(native="args[1]"), print_of(helper="2.0 * x")]
    assert len(set(edited)) == 4
    assert print_of("# moved\n\n" + SERVICE) == edited[0]
    assert service_fingerprint(loaded, "") == edited[0]  # though its file has been edited since
    assert service_fingerprint(loaded, "another wrapper") != edited[0]


def test_constants_that_look_alike_are_told_apart(module):
    def print_of(value):
        return fingerprint(module().make(value), "")

    values = [
        0.1,
        np.float64(0.1),
        np.float32(0.1),
        0.0,
        -0.0,
        0,
        False,
        1,
        True,
        1.0,
        0.1 + 2**-56,
        math.nan,
        (1.0,),
        (1.0, 1.0),
    ]
    assert len({print_of(value) for value in values}) == len(values)


TWO_FILES = """
import json, sys
sys.path.insert(0, sys.argv[1])
from bayesftc import cosim
from bayesftc.cosim import Port; from bayesftc.cosim.stepping.kept import STATISTICS
from other import helper
SHIFT = 1.0
class B(cosim.Block):
    inputs = (Port("z", draw="normal"),)
    outputs = (Port("y"),)
    def define(self, step):
        return cosim.Definition(kernel)
def kernel(y, z):
    y[0] = helper(z[0]) + SHIFT
d = cosim.Diagram(1); d.add(B(), "b"); r = d.simulate(3, record=["b.y", "b.z"])
print(json.dumps([STATISTICS, (r["b.y"] / r["b.z"]).tolist(), r["b.y"].tolist()]))
"""


@pytest.mark.slow
def test_across_processes(python, tmp_path):
    cache, other = tmp_path / "cache", tmp_path / "other.py"

    def run(helper, text=TWO_FILES):
        other.write_text(helper)
        return python(text, tmp_path, cache=cache, stdin=True)

    first = run("def helper(x):\n    return 2.0 * x\n")
    assert first[0] == {"compiled": 2, "loaded": 0}  # the block and the loop
    again = run(
        "# moved\n\ndef helper(x):\n    return 2.0 * x  # so\n", TWO_FILES.replace("SHIFT = 1.0", "# why\nSHIFT = 1.0")
    )
    assert again[0] == {"compiled": 0, "loaded": 2}
    assert again[1:] == first[1:]
    edited = run("def helper(x):\n    return 3.0 * x\n")
    assert edited[0] == {"compiled": 1, "loaded": 1}
    np.testing.assert_allclose((np.array(edited[2]) - 1) / (np.array(first[2]) - 1), 1.5, rtol=1e-12)
    assert len({p.stat().st_mtime for p in cache.rglob("*.py")}) == 1  # whoever writes a text, numba finds it unchanged
    # What is damaged is compiled anew: numba's index, its code, and the text that they belong to.
    files = sorted(p for p in cache.rglob("*") if p.is_file())
    for file in files:
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    assert run("def helper(x):\n    return 3.0 * x\n")[0] == {"compiled": 2, "loaded": 0}
    for file in files:
        if file.suffix in {".nbi", ".nbc", ".o"}:
            file.write_bytes(b"")
    mended = run("def helper(x):\n    return 3.0 * x\n")
    assert mended[0] == {"compiled": 2, "loaded": 0}
    assert mended[1:] == edited[1:]
    assert not list(cache.rglob("*.tmp"))


SMALL = textwrap.dedent("""
    import json, sys
    from bayesftc import cosim
    from bayesftc.cosim.stepping.kept import STATISTICS
    space = {}
    exec("def kernel(t, y):\\n    y[0] = 2.0 * t + 1.0", space)
    class B(cosim.Block):
        outputs = (cosim.Port("y"),)
        def define(self, step):
            return cosim.Definition(space["kernel"])
    step = B().online(1)
    print(json.dumps([STATISTICS, [step().y for _ in range(3)]]))
""")


@pytest.mark.slow
def test_processes_at_once_on_an_empty_cache_and_code_without_a_file(tmp_path):
    environment = {**os.environ, "BAYESFTC_CACHE": str(tmp_path / "cache")}
    command = [sys.executable, "-c", SMALL]
    several = [
        subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    for process in several:
        out, error = process.communicate(timeout=120)
        assert process.returncode == 0, error
        assert json.loads(out)[1] == [1.0, 3.0, 5.0]
    later = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert json.loads(later.stdout) == [{"compiled": 0, "loaded": 1}, [1.0, 3.0, 5.0]]


def test_long_and_foreign_function_names(module, evaluate):
    long, foreign = "k" * 300, "größe"
    for name in (long, foreign):
        written = module(MODULE.replace("def kernel(y)", f"def {name}(y)").replace("return kernel", f"return {name}"))
        assert evaluate(written.make(3.0)) == (9.5, 1)


def nothing_yet(y):
    y[0] = 1.25


def test_cache_folders_that_cannot_be_used(tmp_path, monkeypatch, make_block):
    (tmp_path / "file").write_text("")
    block = make_block(outputs=[Port("y")], output=nothing_yet)
    for root in ("file", "file/below"):
        monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / root))
        with pytest.raises(
            cosim.BayesFTCError, match=r"The cache folder .* cannot be written \(.*\); set BAYESFTC_CACHE to a"
        ):
            block.online(1)
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "gone"))
    (tmp_path / "gone" / "compiled").mkdir(parents=True)

    def read_only(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr("tempfile.mkstemp", read_only)
        with pytest.raises(cosim.BayesFTCError, match=r"cannot be written \(Permission denied\); set BAYESFTC_CACHE"):
            block.online(1)
    assert block.online(1)().y == 1.25


posix = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="Windows has no owners as these")
if hasattr(os, "geteuid"):
    import grp
    import pwd


@posix
@pytest.mark.parametrize("mode", [0o777, 0o770, 0o775, 0o757])
@pytest.mark.parametrize("which", ["", "compiled"])
def test_a_cache_folder_that_others_can_write_is_refused(tmp_path, monkeypatch, which, mode):
    folder = tmp_path / "open" / which
    folder.mkdir(parents=True)
    folder.chmod(mode)
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "open"))
    user = pwd.getpwuid(os.geteuid()).pw_name
    monkeypatch.setattr(grp, "getgrgid", lambda number: grp.struct_group((user, "x", number, [user, "somebody"])))
    with pytest.raises(
        cosim.BayesFTCError, match=r"Other users can write into .* and remove that permission \(chmod go-w "
    ):
        cache_directory("compiled")
    folder.chmod(0o755)
    assert cache_directory("compiled") == tmp_path / "open" / "compiled"
    assert oct((tmp_path / "open" / "compiled").stat().st_mode)[-3:] in {"700", "755"}


@posix
@pytest.mark.parametrize(
    ("name", "main", "accepted"),
    [("user", True, True), ("user", False, False), ("staff", True, False)],
    ids=["private", "of the same name", "of all users"],
)
def test_a_cache_folder_under_umask_002(tmp_path, monkeypatch, name, main, accepted):
    """On Debian and Ubuntu each user has a group, and what the user makes is open to it."""
    folder = tmp_path / "made by the user"
    before = os.umask(0o002)
    try:
        folder.mkdir()
    finally:
        os.umask(before)
    assert folder.stat().st_mode & 0o777 == 0o775
    group = folder.stat().st_gid
    user = pwd.struct_passwd(("user", "x", os.geteuid(), group if main else group + 1, "", "/", "/bin/sh"))
    monkeypatch.setattr(pwd, "getpwuid", lambda number: user)
    monkeypatch.setattr(grp, "getgrgid", lambda number: grp.struct_group((name, "x", number, [])))
    monkeypatch.setenv("BAYESFTC_CACHE", str(folder))
    if accepted:
        assert cache_directory("compiled").stat().st_mode & 0o777 == 0o700
    else:
        with pytest.raises(cosim.BayesFTCError, match="Other users can write into the cache folder"):
            cache_directory("compiled")


@posix
@pytest.mark.parametrize("mask", [0o000, 0o002, 0o022])
def test_a_cache_folder_that_is_new_is_the_users_alone(tmp_path, monkeypatch, mask):
    """Whatever the umask, and whatever default permissions the folder above gives: the system then leaves the mode to those."""
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "a" / "b"))
    mkdir = os.mkdir

    def with_default_permissions(path, mode=0o777, **options):
        mkdir(path, mode, **options)
        os.chmod(path, 0o777 & ~mask)

    monkeypatch.setattr(os, "mkdir", with_default_permissions)
    folder = cache_directory("compiled")
    assert [f.stat().st_mode & 0o777 for f in (folder, folder.parent)] == [0o700] * 2


@posix
@pytest.mark.parametrize("kind", ["compiled", "fmus"])
def test_a_cache_folder_of_someone_else_is_refused(tmp_path, monkeypatch, kind):
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "theirs"))
    (tmp_path / "theirs" / kind).mkdir(parents=True)
    own = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: own + 1)  # as if someone else had made them
    with pytest.raises(
        cosim.BayesFTCError, match=rf"belongs to another user \(number {own}\), who could have put code"
    ):
        cache_directory(kind)


THEIRS = """
import os
from bayesftc.cosim.stepping import compiler as _compiler
is_own = _compiler.is_own
_compiler.is_own = lambda path: path.suffix != SUFFIX and is_own(path)
"""


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".py", ".nbi", ".nbc"])
def test_files_that_others_have_left_are_made_anew(python, tmp_path, suffix):
    """The folder is the user's own now, but was open to others before."""
    first = python(SMALL, cache=tmp_path)
    assert python(SMALL, cache=tmp_path) == [{"compiled": 0, "loaded": 1}, first[1]]
    again = python(THEIRS.replace("SUFFIX", repr(suffix)) + SMALL, cache=tmp_path)
    assert again == [{"compiled": 1, "loaded": 0}, first[1]]


@posix
def test_an_fmu_that_others_have_unpacked_is_unpacked_anew(tmp_path, monkeypatch):
    from bayesftc.cosim.fmi.reading import archive

    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path))
    opened = archive.open_archive(Path(fmus.path("CruiseControl")))
    folder = archive.extract(opened, "modelDescription.xml")
    (folder / "modelDescription.xml").write_text("theirs")
    assert (archive.extract(opened, "modelDescription.xml") / "modelDescription.xml").read_text() == "theirs"
    theirs = [True]
    monkeypatch.setattr(archive, "is_own", lambda path: not theirs)
    original = archive._unpack
    monkeypatch.setattr(archive, "_unpack", lambda *arguments: (theirs.clear(), original(*arguments)))
    assert (
        "fmiModelDescription" in (archive.extract(opened, "modelDescription.xml") / "modelDescription.xml").read_text()
    )


FULL = """
import json, resource
from bayesftc import cosim
diagram = cosim.Diagram(dt=0.1)
diagram.add(cosim.Sine(1.0, 1.0), "wave")
resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
try:
    diagram.simulate(1.0, engine="compiled")
except cosim.BayesFTCError as error:
    print(json.dumps(str(error)))
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="limits the size of files")
def test_a_full_cache_folder_ends_in_a_sentence(python, tmp_path):
    said = python(FULL, cache=tmp_path)
    assert f"The cache folder {tmp_path / 'compiled'} cannot be written (File too large); set BAYESFTC_CACHE" in said
    assert not [p for p in tmp_path.rglob("*") if p.is_file() and p.suffix != ".py"]  # no half of anything


def test_a_second_run_of_a_built_diagram_does_not_hash_again(monkeypatch):
    diagram = cosim.Diagram(1)
    diagram.add(cosim.Ramp(1.0))
    diagram.simulate(1)
    monkeypatch.setattr(_steps, "fingerprint", lambda *a: pytest.fail("hashed again"))
    assert diagram.simulate(2)["ramp.y"].tolist() == [0, 1, 2]
