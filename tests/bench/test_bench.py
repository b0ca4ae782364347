import io
import json
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console

from bayesftc import bench
from bayesftc.bench import _child, _machine, _run
from bayesftc.bench._figures import Figure, Section, in_turns, ratios
from bayesftc.bench._slave import unpacked_fmu
from bayesftc.bench.measures import executors, plain_loop
from bayesftc.bench.measures.full_loop import SETTING
from bayesftc.bench.measures.limit.by_hand import compiled
from bayesftc.cosim.base import extras
from bayesftc.fmus._compiler import CompilerError

BARS = {
    "export.c",
    *(f"export.{what}_{size}" for what in ("write", "compile") for size in ("1x2", "2x3")),
    "plain_loop.engine_over_c", "plain_loop.engine_over_fmpy", "plain_loop.difference", "plain_loop.live",
    "limit.engine_over_own", "limit.difference",
    "coupled.engine", "coupled.difference",
    "model_exchange.free_cvode_over_fmpy", "model_exchange.driven_cvode_over_fmpy",
    "full_loop.engine", "full_loop.engine_over_user", "full_loop.difference", "full_loop.rmse_ratio",
    "fit.seconds", "fit.over_fmpy", "fit.difference",
    "campaign.threads", "campaign.scaling", "campaign.overhead", "campaign.over_user", "campaign.large", "campaign.large_memory",
    "report.report", "report.report_memory",
    "executors.dask_over_process",
    "isolation.isolated", "isolation.difference", "isolation.lives",
    "learners.per_sensor", "learners.growth",
    "large_diagrams.build", "large_diagrams.run", "large_diagrams.build_growth", "large_diagrams.run_growth",
    "console.watched",
    "live.within", "live.misses_over_sleeping",
    "startup.import", "startup.help", "startup.scenario", "startup.scenario_compiled", "startup.second_engine",
    "memory.growth_over_recording",
}  # fmt: skip


@pytest.fixture(scope="module")
def sections():
    return list(bench.measure(quick=True))


@pytest.fixture(scope="module")
def report(sections):
    return json.loads(json.dumps(_run.as_json(sections, quick=True)))


@pytest.mark.slow
def test_report_has_every_section_and_bar(report):
    assert set(report) == {"machine", "quick", "bars", *bench.SECTIONS}
    assert report["quick"] is True
    assert set(report["bars"]) == BARS


@pytest.mark.slow
def test_every_bar_has_a_number_or_a_reason(report):
    for bar in report["bars"].values():
        assert isinstance(bar["value"], float) != bool(bar["reason"])
        assert isinstance(bar["met"], bool) or bar["reason"]
        assert {"at_least", "at_most"} & set(bar)


@pytest.mark.slow
def test_every_figure_has_median_min_and_max_or_a_reason(report):
    for section in bench.SECTIONS:
        for figure in report[section].values():
            if figure["samples"]:
                assert figure["min"] <= figure["median"] <= figure["max"]
            else:
                assert figure["median"] is None
                assert figure["reason"].endswith(".")


@pytest.mark.slow
def test_what_is_compared_computes_the_same(report):
    assert report["bars"]["plain_loop.difference"]["met"]
    assert report["bars"]["full_loop.difference"]["met"]


@pytest.mark.slow
def test_compiled_code_is_kept(report):
    assert report["startup"]["scenario_compiled"]["max"] == 0
    assert report["startup"]["first_compiled"]["min"] > report["startup"]["second_compiled"]["max"] > 0
    assert report["startup"]["first_engine"]["min"] > 0 == report["startup"]["second_engine"]["max"]


@pytest.mark.slow
def test_report_does_not_name_this_machine(report):
    import platform

    text = json.dumps(report)
    assert str(Path(__file__).parents[2]) not in text
    assert str(Path(sys.prefix)) not in text
    assert f'"{platform.node()}"' not in text
    assert set(report["machine"]) >= {"cpu", "cores", "python", "numba"}


@pytest.mark.slow
def test_tables_show_every_figure(sections):
    for section in sections:
        assert _run.as_table(section).row_count == len(section.figures)


def test_json_is_one_object(capsys):
    bench.main(json=True, quick=True, sections=["plain_loop"])
    assert set(json.loads(capsys.readouterr().out)) == {"machine", "quick", "plain_loop", "bars"}


@pytest.mark.slow
def test_table_says_that_a_bar_is_missed(capsys):
    missed = Figure("a", "a figure", "s", [3.0, 1.0, 2.0], at_most=1.5)
    assert _run._verdict(Section("s", "S", (missed,)), missed) == "[yellow]not reached here[/]"
    bench.main(quick=True, sections=["memory"])
    out = capsys.readouterr().out
    assert "peak growth" in out
    assert "quick figures" in out


def test_one_of_two_alternatives_is_enough():
    fast = Figure("fast", "", "", [5.0], at_least=4.0, either="speed")
    slow = Figure("slow", "", "", [50.0], at_least=100.0, either="speed")
    alone = Figure("alone", "", "", [50.0], at_least=100.0)
    unknown = Figure("unknown", "", "", [], at_least=1.0, reason="There is none.")
    section = Section("s", "S", (fast, slow, alone, unknown))
    assert [section.met(f) for f in section.figures] == [True, True, False, None]
    assert _run._verdict(section, slow) == "by the alternative"
    assert "not reached here" in _run._verdict(section, alone)
    assert section.bars()["s.slow"]["or"] == ["s.fast"]
    assert section.bars()["s.unknown"] == {"value": None, "at_least": 1.0, "met": None, "reason": "There is none."}


@pytest.mark.parametrize("section", ["executors", "report"])
def test_without_the_extra_the_rest_is_measured_and_a_reason_says_what_to_install(section, monkeypatch):
    monkeypatch.setattr(extras, "find_spec", lambda name: None if name in {"distributed", "pyarrow"} else object())
    for slow in ("_campaign", "_rate"):  # what is measured without the extra is not what is tested
        monkeypatch.setattr(executors, slow, lambda *_, **__: (1.0, 2.0))
    measured = import_module(f"bayesftc.bench.measures.{section}").measure(quick=True)
    console = Console(width=210, file=io.StringIO())
    console.print(_run.as_table(measured))
    assert "pip install 'bayesftc[campaign]'" in console.file.getvalue()
    figures = measured.figures
    reasons = {figure.reason for figure in figures if not figure.samples}
    (reason,) = reasons
    assert re.search(r"needs the package (distributed|pyarrow), .*: pip install 'bayesftc\[campaign\]'\.$", reason)
    assert {f.key for f in figures if f.samples} == (
        {"process", "process_start", "in_process", "overhead"} if section == "executors" else set()
    )


def _three_sections(monkeypatch, last):
    """Let there be three measurements: one that is made, one that cannot be made, one that ends as given."""

    def refused(quick):
        raise CompilerError("No C compiler was found.")

    made = SimpleNamespace(measure=lambda quick: Section("made", "Made", (Figure("a", "a figure", "s", [1.0]),)))
    modules = {"made": made, "refused": SimpleNamespace(measure=refused), "last": SimpleNamespace(measure=last)}
    monkeypatch.setattr(_run, "import_module", lambda name: modules[name.rpartition(".")[2]])
    monkeypatch.setattr(_run, "SECTIONS", tuple(modules))


@pytest.mark.parametrize("json_", [False, True])
def test_what_was_measured_is_kept(monkeypatch, capsys, json_):
    """One section that cannot be measured, and Ctrl-C in the next."""

    def stopped(quick):
        raise KeyboardInterrupt

    _three_sections(monkeypatch, stopped)
    with pytest.raises(KeyboardInterrupt):
        bench.main(json=json_, sections=["made", "refused", "last"])
    out = capsys.readouterr().out
    if json_:
        assert json.loads(out)["made"]["a"]["median"] == 1.0
        assert json.loads(out)["refused"] == {"reason": "No C compiler was found."}
    else:
        assert "a figure" in out
        assert "The targets are the project's own" in out
        assert "Refused: No C compiler was found." in out


def test_a_table_is_there_before_the_next_section_is_measured(monkeypatch, capsys):
    printed = []

    def look(quick):
        printed.append(capsys.readouterr().out)
        return Section("last", "Last", ())

    _three_sections(monkeypatch, look)
    bench.main(sections=["made", "last"])
    assert "a figure" in printed[0]


def test_candidates_take_turns():
    order = []
    samples = in_turns({n: lambda n=n: order.append(n) or 2.0 for n in "abc"}, 2)
    assert order == [*"abcabc"]
    assert ratios(samples["a"], [1.0, 4.0]) == [2.0, 0.5]


def test_without_a_compiler_there_is_a_reason(monkeypatch):
    def refuse(folder):
        raise CompilerError("No C compiler was found.")

    monkeypatch.setattr(plain_loop, "compile_c_loop", refuse)
    section = plain_loop.measure(quick=True)
    bar = section.bars()["plain_loop.engine_over_c"]
    assert bar["value"] is None
    assert bar["reason"].startswith("No C compiler")
    assert section.bars()["plain_loop.engine_over_fmpy"]["value"] is not None


@pytest.mark.slow
def test_the_loop_by_hand_computes_the_same_and_each_part_can_be_left_out():
    (limit,) = bench.measure(["limit"], quick=True)
    assert limit.bars()["limit.difference"]["value"] < 1e-12
    with unpacked_fmu() as car, compiled(car, SETTING) as by_hand:
        whole = by_hand("whole_loop", 1000)[0]
        assert (by_hand("without_recording", 1000)[0][0] == whole[-1]).all()
        quiet = by_hand("without_random", 1000)[0]
        assert (quiet[:300, 0] == quiet[:300, 1]).all()  # sensors without noise
        assert (by_hand("without_fmu", 1000)[0][:, 0] == SETTING.start_speed).all()
        assert (by_hand("without_control", 1000)[0][:, 3] == 0.0).all()


def test_a_process_that_fails_is_told_without_its_paths():
    with pytest.raises(
        _child.ChildError, match=r"^A process of the measurement failed with FileNotFoundError \(exit status 1\)\.$"
    ):
        _child.run_code("open('/some/path')")
    with pytest.raises(_child.ChildError, match=r"failed \(exit status 3\)"):
        _child.run_code("raise SystemExit(3)")


def test_machine_without_a_processor_table(monkeypatch):
    monkeypatch.setattr(_machine.Path, "is_file", lambda path: False)
    assert isinstance(_machine._processor(), str)


def test_import_is_light():
    code = "import sys, bayesftc.bench; print(sorted({'numba', 'rich', 'fmpy', 'numpy'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_section_is_measured_alone_by_its_name(bayesftc_):
    done = bayesftc_("bench", "plain_loop", "--quick", "--json")
    assert set(json.loads(done.stdout)) == {"machine", "quick", "plain_loop", "bars"}
    wrong = bayesftc_("bench", "campain")
    assert wrong.exit_code == 5
    assert "did you mean 'campaign'" in wrong.stderr
