"""What several test modules share."""

import ctypes
import gc
import io
import json
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import warnings
import zipfile
from collections import defaultdict
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from threading import Timer

# The tests' matrices are small. What threads of their own for products of them do is wait, on the cores of the other tests.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Where Python is told to keep no bytecode, each of the hundreds of processes of the tests would compile all that it imports.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import hypothesis
import numpy as np
import pytest

from bayesftc import fmus
from bayesftc.cosim import Block, Definition, Diagram, Table
from bayesftc.cosim.stepping.machine import steps

steps.lenient = False  # whatever is wrong on the way from a step function to machine code fails a test

# On a busy machine, examples that take long say nothing about the tests.
hypothesis.settings.register_profile("busy", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow])
hypothesis.settings.load_profile("busy")

# A shell starts what runs in the background deaf to Ctrl-C, and so would be the tests of it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The tests' compiled code stays out of the user's cache, but is kept from run to run.
os.environ.setdefault("BAYESFTC_CACHE", str(Path(__file__).resolve().parents[1] / ".pytest_cache" / "bayesftc"))


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Keep the garbage collector off a million objects of imports and tests: nearly half of what collecting tests took."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Of the cases of a test that is marked ``sampled(n)``, leave n to the quick tests, evenly spread; the others are slow."""
    cases = defaultdict(list)
    for item in items:
        if (mark := item.get_closest_marker("sampled")) and not item.get_closest_marker("slow"):
            cases[item.nodeid.partition("[")[0], mark.args[0]].append(item)
    for (_, count), found in cases.items():
        kept = {round(i * (len(found) - 1) / max(count - 1, 1)) for i in range(count)}
        for i, item in enumerate(found):
            if i not in kept:
                item.add_marker(pytest.mark.slow)


@pytest.fixture(autouse=True)
def closed_figures():
    """Close the figures of a test. python-control opens them by pyplot, which warns of more than 20, in any test."""
    yield
    if pyplot := sys.modules.get("matplotlib.pyplot"):
        pyplot.close("all")


def assert_bits(a, b, what=""):
    a, b = np.asarray(a), np.asarray(b)
    assert a.shape == b.shape, (what, a.shape, b.shape)
    same = (a.view(np.uint64) == b.view(np.uint64)) | (np.isnan(a) & np.isnan(b))
    assert same.all(), (what, np.argwhere(~same)[:3].tolist(), a[~same][:3], b[~same][:3])


@pytest.fixture(scope="session")
def same_bits():
    """Equality of every bit; all NaNs are one."""
    return assert_bits


@pytest.fixture(scope="session")
def run_both():
    """Simulate in both engines, insist on the same bits, and return the result."""

    def run(diagram, duration, **options):
        compiled = diagram.simulate(duration, engine="compiled", **options)
        interpreted = diagram.simulate(duration, engine="interpreted", **options)
        assert list(compiled) == list(interpreted)
        for name in compiled:
            assert_bits(compiled[name], interpreted[name], name)
        assert_bits(compiled.time, interpreted.time)
        return compiled

    return run


@pytest.fixture(scope="session")
def campaign_as_alone():
    """Make runs as a campaign does, from run to run, and insist on the bits and reasons that each has alone; return the table."""

    def run(diagram, duration, seeds=(3, 1, 4, 159), points=None, **options):
        from bayesftc import cosim
        from bayesftc.cosim.campaign.runs.truth import FAULTY, MISSING
        from bayesftc.cosim.errors import SimulationError

        settings = {"record": ["*"], "piece": len(seeds) + 1, **options}
        campaign = cosim.Campaign(diagram, duration=duration, grid=points, seeds=seeds, **settings)
        with warnings.catch_warnings():
            warnings.filterwarnings("error", "An FMU gives other results")
            result = campaign.run(executor=cosim.Threads(1))
        data, table = result.dataset, result.table
        for number, reason in enumerate(table["reason"]):
            try:
                alone = campaign.replay(number, record=settings["record"], decimation=settings.get("decimation", 1))
                said = alone.stopped or ""  # an FMU has ended it
            except SimulationError as error:
                alone, said = error.result, str(error)
            assert reason == said
            assert set(alone) == {str(name) for name in data.data_vars} - {FAULTY, MISSING}  # judged, no signals
            for name in alone:
                rows = len(alone[name])
                assert_bits(data[name][number].values[:rows], alone[name], (number, name))
                assert np.isnan(data[name][number].values[rows:]).all()
        return table

    return run


@pytest.fixture(scope="session")
def make_block():
    """Return a block from its parts, without writing a class."""

    def make(*, inputs=(), outputs=(), finite=False, sample_time=None, name="custom", **definition):
        parts = {
            "inputs": property(lambda self: tuple(inputs)),
            "outputs": property(lambda self: tuple(outputs)),
            "sample_time": property(lambda self: sample_time),
            "checks_finite": finite,
            "define": lambda self, step: Definition(**definition),
        }
        return type(name.capitalize(), (Block,), parts)()

    return make


@pytest.fixture(scope="session")
def fed():
    """Return the diagram of a block that is fed from tables, of a value for each step of 0.02 s."""

    def build(block, values, name="block"):
        diagram = Diagram(0.02)
        node = diagram.add(block, name)
        for port, rows in values.items():
            times = np.arange(rows.shape[1]) / 50
            tables = [diagram.add(Table(times, row, interpolate=False), f"{port}{i}") for i, row in enumerate(rows)]
            diagram.connect([table["y"] for table in tables], node[port])
        return diagram

    return build


@pytest.fixture(scope="session")
def python():
    """Run a Python text in a process of its own and return what it prints last, read as JSON."""

    def run(text, *arguments, cache=None, stdin=False, timeout=120):
        environment = dict(os.environ)
        if cache is not None:
            environment["BAYESFTC_CACHE"] = str(cache)
        command = [sys.executable, *(["-"] if stdin else ["-c", text]), *map(str, arguments)]
        done = subprocess.run(
            command, input=text if stdin else None, env=environment, capture_output=True, text=True, timeout=timeout
        )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    return run


RENAMED = {
    "2.0": {"DoStep": "DoStep", "GetReal": "Get", "Instantiate": "Instantiate"},
    "3.0": {"DoStep": "DoStep", "GetFloat64": "Get", "InstantiateCoSimulation": "Instantiate"},
}
"""Functions of the shipped car that lying.c replaces, and how it calls them."""


@pytest.fixture(scope="session")
def c_compiler():
    """Return the command of a C compiler; skip without one."""
    found = next((c for c in ("cc", "gcc", "clang") if shutil.which(c)), None)
    return found or pytest.skip("there is no C compiler to build FMUs with")


@pytest.fixture(scope="session")
def lying(tmp_path_factory, c_compiler):
    """Return the path of an FMU that lies (lying.c), built once, and the numbers of the ways in which it does."""
    if sys.platform != "linux":
        pytest.skip("needs Linux")
    compiler = c_compiler
    source = Path(__file__).with_name("lying.c")
    names = re.search(r"enum \{(.*?)\}", source.read_text(), re.DOTALL)[1].replace("= 1000", "").split(",")
    ways = {name.strip(" _\n"): 1000.0 + i for i, name in enumerate(names)}
    built = {}

    def build(fmi):
        if fmi in built:
            return built[fmi], ways
        folder = tmp_path_factory.mktemp("lying")
        prefix = f"fmi{fmi[0]}"
        renamed = {**RENAMED[fmi], "FreeInstance": "Free", "ExitInitializationMode": "Exit"}
        target = folder / "Lying.fmu"
        with zipfile.ZipFile(fmus.path("CruiseControl", fmi=fmi)) as old, zipfile.ZipFile(target, "w") as new:
            for name in old.namelist():
                if name.startswith("sources/"):
                    (folder / Path(name).name).write_bytes(old.read(name))
            text = (folder / f"{prefix}.c").read_text()
            for name, other in renamed.items():
                text, count = re.subn(rf"\b{prefix}{name}\(", f"original_{other}(", text)
                assert count == 1
            (folder / f"{prefix}.c").write_text(text)
            sources = [f"{prefix}.c", "CruiseControl.c", str(source)]
            flags = ["-O1", "-fPIC", "-shared", "-I.", f"-DFMI{fmi[0]}", "-o", "library.so"]
            subprocess.run([compiler, *flags, *sources, "-lm"], cwd=folder, check=True)
            library = (folder / "library.so").read_bytes()
            for name in old.namelist():
                new.writestr(name, library if name.endswith(".so") else old.read(name))
        built[fmi] = target
        return target, ways

    return build


@pytest.fixture
def bayesftc_(tmp_path, monkeypatch):
    """Run a command in an empty folder."""
    from typer.testing import CliRunner

    from bayesftc.cli import app

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")

    def run(*arguments):
        return CliRunner().invoke(app, [str(a) for a in arguments], prog_name="bayesftc")

    return run


@pytest.fixture
def undrawn(monkeypatch):
    """Save an empty figure in place of each: of six panels it takes 0.7 s, which a test of the files beside it can save."""
    from matplotlib.figure import Figure

    usual = Figure.savefig

    def save(self, file, **settings):
        usual(Figure(self.get_size_inches()), file, **settings)

    monkeypatch.setattr(Figure, "savefig", save)


TELLING = """
import sys
from contextlib import contextmanager
from importlib import import_module
from bayesftc.__main__ import main
from bayesftc.cli.application import COMMANDS

@contextmanager
def tell(*names, shown):
    yield lambda *progress: print(*progress, flush=True)

folder, _ = COMMANDS[sys.argv[1]]
import_module(f"bayesftc.cli.commands.{folder}.{sys.argv[1]}")._progress = tell
main()
"""


@pytest.fixture
def stopped_by_ctrl_c(tmp_path):
    """Stop a command line, run in `tmp_path`, once it prints progress with some beginning; return exit code and stderr."""

    def run(*arguments, after=""):
        process = subprocess.Popen(
            [sys.executable, "-c", TELLING, *arguments],
            cwd=tmp_path,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            # A test runner in the background hands down an ignored SIGINT; the process is to have the usual one.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )
        end = Timer(120, process.kill)  # then reading ends, and what is asserted of it fails
        end.start()
        try:
            assert any(line.startswith(after) for line in process.stdout), process.stderr.read()
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=60)
        finally:
            end.cancel()
            process.kill()
        return process.returncode, errors

    return run


@pytest.fixture(scope="session")
def printed():
    """Return what an experiment prints on a terminal of 80 columns, which no row of a table may exceed, on one line."""
    from rich.console import Console
    from rich.measure import Measurement

    def text(parts):
        console, found = Console(width=80, record=True, file=io.StringIO()), []
        for part in parts:
            if isinstance(part, str):
                found.append(part)
                continue
            title, table = part.renderables
            assert Measurement.get(console, console.options.update(width=500), table).maximum <= 80, title
            console.print(part)
            found.append(console.export_text())
        return "\n".join(found)

    return text


@pytest.fixture(scope="session")
def casadi_fmu(tmp_path_factory, c_compiler):
    """Return an FMU for model exchange that CasADi exports: q'' = -9.81 sin q - 0.1 q' + u, q(0) = 0.5, any output y."""

    def export(name, output):
        import fmpy

        ca = pytest.importorskip("casadi")
        compiler = c_compiler
        dae = ca.DaeBuilder(name)
        q, w, u, y = dae.add("q"), dae.add("w"), dae.add("u", "input"), dae.add("y", "output")
        for state, value in (("q", w), ("w", -9.81 * ca.sin(q) - 0.1 * w + u)):
            dae.eq(dae.der(dae.var(state)), value)
        dae.eq(y, output(q, u))
        dae.set_start("q", 0.5)
        folder, here = tmp_path_factory.mktemp("casadi"), os.getcwd()
        os.chdir(folder)  # it writes where one is
        try:
            files = dae.export_fmu()
        finally:
            os.chdir(here)
        library = folder / f"{name}{fmpy.sharedLibraryExtension}"
        sources = [str(folder / file) for file in files if file.endswith(".c")]
        headers = [f"-I{Path(fmpy.__file__).parent / 'c-code'}", f"-I{folder}"]
        subprocess.run(
            [compiler, "-shared", "-fPIC", "-O2", "-w", *headers, *sources, "-o", str(library), "-lm"], check=True
        )
        target = folder / f"{name}.fmu"
        with zipfile.ZipFile(target, "w") as archive:
            for file, place in files.items():
                archive.write(folder / file, place.removeprefix("./"))
            archive.write(library, f"binaries/{fmpy.platform_tuple}/{library.name}")
        return target

    return export


@pytest.fixture(scope="session")
def ecos():
    """Return Ecos, another tool that runs FMUs and SSP, written in C++: it steps all FMUs side by side."""
    if sys.platform != "linux" or platform.machine() != "x86_64":
        pytest.skip("ecos is there for Linux on x86-64 only")
    try:
        library = next(file for file in files("tbb") if file.name == "libtbb.so.12")  # which its own library looks for
    except PackageNotFoundError:
        pytest.skip("ecos needs the package tbb")
    ctypes.CDLL(str(library.locate().resolve()), mode=ctypes.RTLD_GLOBAL)
    return pytest.importorskip("ecospy")
