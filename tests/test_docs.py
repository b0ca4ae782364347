"""Documentation that cannot drift: README and pages run, and every public argument is described."""

import gc
import inspect
import re
import subprocess
import sys
import tomllib
import unicodedata
from dataclasses import fields, is_dataclass
from pathlib import Path
from urllib.parse import unquote

import public_names
import pytest
import readme
import repository_files

from bayesftc import controllers, cosim, fmus, monitoring
from bayesftc.cosim.judging import metrics
from bayesftc.fmus._compiler import why_no_compiler
from bayesftc.scenario import load_scenario

ROOT = Path(__file__).resolve().parents[1]
MADE = {"project", "api"}
"""Folders that the site writes."""
PAGES = [p for p in sorted((ROOT / "docs").rglob("*.md")) if not MADE & set(p.parts)]
PAGES.append(ROOT / "README.md")  # last: its loops are compiled by then
MODULES = (cosim, cosim.live, cosim.statistics, controllers, monitoring)
PUBLIC = {f"{m.__name__}.{n}": getattr(m, n) for m in MODULES for n in m.__all__}

WITH_EXAMPLES = (*MODULES, fmus)
"""Modules in which every public name has an example."""

RECIPES = [p for p in PAGES if p.parent.name == "how-to" and p.name != "index.md"]
LONG = {
    ROOT / "docs" / page
    for page in (
        "tutorials/bring-your-own-fmu.md",
        "tutorials/campaign.md",
        "tutorials/design-to-firmware.md",
        "reference/campaigns.md",
        "reference/design.md",
        "reference/export.md",
        "reference/statistics.md",
        "reports/detectability.md",
        "reports/other-tools.md",
        "explanation/precision.md",
        "reports/reproduce.md",
        "reference/python-control.md",
        "reference/fit.md",
        "reference/coupling.md",
        "tutorials/first-loop.md",  # the README's loop
        "how-to/run-faster.md",
    )
} | set(RECIPES) - set(RECIPES[::7])
"""Pages whose snippets take long, and six of seven recipes, which are much alike."""


@pytest.mark.parametrize(
    "page",
    [pytest.param(p, marks=[pytest.mark.slow] * (p in LONG)) for p in PAGES if readme.python(p)],
    ids=lambda p: p.relative_to(ROOT).as_posix(),
)
def test_snippets_run(page, tmp_path, monkeypatch, capsys):
    """The README in a process of its own, as one who is new runs it; the pages here, where much is imported and compiled."""
    if "needs a C compiler" in readme.python(page) and why_no_compiler():
        pytest.skip(why_no_compiler())
    if page.name == "README.md":
        assert "seeds=50" in readme.python(page)  # 200 runs took most of the test, and nothing of them is compared here
        command = [sys.executable, "-c", readme.python(page).replace("seeds=50", "seeds=2")]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
        printed = done.stdout
    else:
        monkeypatch.chdir(tmp_path)
        monkeypatch.syspath_prepend(tmp_path)  # of modules that a page writes, as for a script in this folder
        names = {"__name__": "__main__"}
        try:
            exec(compile(readme.python(page), page.name, "exec"), names)
        finally:  # as at the end of a process: what a page leaves open is closed
            names.clear()
            gc.collect()
        printed = capsys.readouterr().out
    for expected in re.findall(r"^ *print\(.*\)  # (.*)(?<!\.\.\.)$", readme.python(page), re.M):
        assert expected in printed.splitlines()


def test_what_the_page_on_extending_names_is_there():
    """Files by the end of their path; of names with dots each part must stand somewhere in the code."""
    folders = [ROOT / name for name in ("benchmarks", "controllers", "cosim", "docs", "fmus", "src", "tests", "tools")]
    files = [f for folder in folders for end in ("py", "pyi", "c", "h", "md") for f in folder.rglob(f"*.{end}")]
    files.append(ROOT / "CHANGELOG.md")
    words = {word for f in files if f.suffix != ".md" for word in re.findall(r"\w+", f.read_text(encoding="utf-8"))}
    prose = re.sub(
        r"^```.*?^```", "", (ROOT / "docs" / "reference" / "extend.md").read_text(encoding="utf-8"), flags=re.S | re.M
    )
    named = {name.removeprefix("python ").removeprefix("bayesftc.") for name in re.findall(r"`([^`]+)`", prose)}
    for name in named:
        if re.fullmatch(r"[\w/*]+\.(py|pyi|c|h|md)", name):
            assert any(f.match(name) for f in files), f"{name} is no file"
        elif re.fullmatch(r"[\w.]+(\(.*\))?", name):
            missing = [word for word in re.findall(r"\w+", name.partition("(")[0]) if word not in words]
            assert not missing, f"{name}: nothing is called {missing[0]}"
    assert len(named) > 100


def anchors(page):
    """Return the anchors of a page's headings, as GitHub makes them; none twice."""
    prose = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.S | re.M)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in re.findall(r"^#+ (.*)$", prose, re.M)}


def test_links_of_the_pages_lead_somewhere():
    for page in [*PAGES, *(ROOT / f"{name}.md" for name in ("CHANGELOG", "CONTRIBUTING", "SECURITY"))]:
        for target, anchor in re.findall(r"\]\(([^)#]*)#?([^)]*)\)", page.read_text(encoding="utf-8")):
            if "://" not in target:
                linked = page.parent / target if target else page
                assert linked.exists(), f"{page.name} links to {target}"
                assert not anchor or anchor in anchors(linked), f"{page.name} links to {target}#{anchor}"


CITATION = (
    r"([A-Z][a-z][\w'-]+)(?:,? [A-Z][\w'-]+)*(?:,? and [A-Z][\w'-]+| et al\.)?"
    r"(?: \(|, |,? [A-Z][^()]{0,60}, | )((?:19|20)\d\d)\b"
)
"""Names and a year: "Kim 1994", "Dennis, Gay and Welsch (1981)", "Huang et al., IEEE TAES 53, 2017"."""


def unaccented(text):
    return unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()


def test_each_cited_work_has_a_row_in_the_page_of_papers():
    papers = ROOT / "docs" / "reference" / "literature.md"
    rows = [unaccented(row) for row in papers.read_text(encoding="utf-8").splitlines() if row.startswith("|")]
    sources = [file for folder in ("controllers", "cosim", "src") for file in (ROOT / folder).rglob("*.py")]
    for file in {*PAGES, *sources} - {papers}:
        for name, year in re.findall(CITATION, unaccented(" ".join(file.read_text(encoding="utf-8").split()))):
            known = name in {"Dymola", "November"} or any(
                name.removesuffix("'s") in row and year in row for row in rows
            )
            assert known, f"{file.name} cites {name} {year}: add it to docs/reference/literature.md"


def test_links_to_papers_have_the_doi_that_they_show():
    text = (ROOT / "docs" / "reference" / "literature.md").read_text(encoding="utf-8")
    links = re.findall(r"\[(10\.[^\]]+)\]\(https://doi\.org/([^)]+)\)", text)
    assert len(links) > 40
    assert all(unquote(target) == shown for shown, target in links)


SCRIPTS = [ROOT / "docs" / "_site" / "scorer.js", ROOT / "docs" / "_site" / "static" / "site.js"]
NEWER = {
    r"\(\?<[=!]": "lookbehind",
    r"\.(with|at|findLast|findLastIndex|toSorted|toReversed|toSpliced)\(": "a method of arrays since 2022",
    r"structuredClone": "structuredClone",
    r"groupBy": "groupBy",
}
"""What some browsers of the last five years lack."""


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_scripts_of_the_site_run_in_browsers_that_are_five_years_old(script):
    text = script.read_text(encoding="utf-8")
    found = [feature for pattern, feature in NEWER.items() if re.search(pattern, text)]
    assert not found, f"{script.name} uses {', '.join(found)}"


def test_every_page_leads_to_the_glossary():
    for page in PAGES:
        if page.name != "glossary.md":
            assert "glossary.md)" in page.read_text(encoding="utf-8"), f"{page.name} does not link to the glossary"


def test_the_page_on_installation_has_every_extra():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    rows = re.findall(r"^\| `(\w+)` \|", (ROOT / "docs" / "install.md").read_text(encoding="utf-8"), re.M)
    assert sorted(rows) == sorted(extras)


def test_every_recipe_has_words_by_which_the_search_finds_it():
    without = [p.name for p in RECIPES if "\nAlso called: " not in p.read_text(encoding="utf-8")]
    assert not without, f"pages without a line 'Also called: ...': {without}"


def test_code_in_a_link_is_no_link_of_its_own():
    pytest.importorskip("sphinx")
    from docutils import nodes
    from linked_names import is_linked

    alone, within = nodes.literal("", "FMU"), nodes.literal("", "FMU")
    nodes.paragraph("", "", alone)
    nodes.reference("", "", nodes.inline("", "the ", within), refuri="page.html")
    assert is_linked(within)
    assert not is_linked(alone)


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_every_public_name_is_described_with_all_its_arguments(name):
    thing = PUBLIC[name]
    if not (inspect.isclass(thing) or inspect.isfunction(thing)):
        return
    text = inspect.getdoc(thing)
    assert text, f"{name} has no docstring"
    if inspect.isclass(thing) and issubclass(thing, Exception):
        return
    members = [thing] if inspect.isfunction(thing) else []
    if inspect.isclass(thing):
        text += "".join(inspect.getdoc(base) or "" for base in thing.__mro__[1:-1])
        members.append(thing.__init__)
        for attribute, member in vars(thing).items():
            if not attribute.startswith("_") and (callable(member) or isinstance(member, property)):
                assert inspect.getdoc(getattr(thing, attribute)), f"{name}.{attribute} has no docstring"
    for member in members:
        try:
            parameters = inspect.signature(member).parameters.values()
        except (TypeError, ValueError):
            continue
        for parameter in parameters:
            described = re.search(rf"\b{re.escape(parameter.name)}\b", text)
            assert parameter.name in {"self", "args", "kwargs"} or described, (
                f"{name} does not describe {parameter.name!r}"
            )


@pytest.mark.parametrize("name", sorted(name for name, thing in PUBLIC.items() if inspect.isfunction(thing)))
def test_every_public_function_says_what_it_returns(name):
    """Its page shows no annotations, only the docstring."""
    text = inspect.getdoc(PUBLIC[name])
    if inspect.signature(PUBLIC[name]).return_annotation not in {None, "None"}:
        assert re.search(r"^(Returns|Yields)\n-+\n\S.*\n    \S", text, re.M), f"{name} has no section Returns"


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_every_setting_on_a_page_has_a_type(name):
    """Those of a base are completed from its description."""
    inherited = pytest.importorskip("inherited_parameters", exc_type=ImportError)
    thing = PUBLIC[name]
    if inspect.isclass(thing):
        text = inherited.completed(thing, inspect.getdoc(thing))
    elif inspect.isfunction(thing):
        text = inspect.getdoc(thing)
    else:
        return
    without = [entry.name for entry in inherited.NumpyDocString(text)["Parameters"] if not entry.type]
    assert not without, f"{name} gives no type of {'; '.join(without)}"


def has_example(thing):
    """Return whether an example stands in a docstring of a class or function, or of one of the class's own methods."""
    own = [getattr(thing, name) for name in vars(thing) if not name.startswith("_")] if inspect.isclass(thing) else []
    methods = [each for each in own if callable(each) or isinstance(each, property)]  # not numbers: int has an example
    return any(">>>" in (each.__doc__ or "") for each in (thing, *methods))


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_every_public_name_has_an_example(name):
    """Exceptions, constants and type aliases need none."""
    thing = PUBLIC[name]
    module = name.rpartition(".")[0]
    if module not in {each.__name__ for each in WITH_EXAMPLES} or not (
        inspect.isfunction(thing) or (inspect.isclass(thing) and not issubclass(thing, BaseException))
    ):
        return
    assert has_example(thing), f"{name} has no example; end its docstring with a section Examples"


def test_examples_folder_ships_with_the_package():
    import bayesftc.examples

    assert (Path(bayesftc.examples.__file__).parent / "cruise_control" / "cruise_control.toml").is_file()
    assert fmus.path("CruiseControl").is_file()


def test_whatever_is_listed_is_public():
    """A fault, learner, source, law, controller or model that is forgotten in the stub cannot be reached by name."""
    from bayesftc.cosim.campaign.executors.choice import EXECUTORS
    from bayesftc.cosim.campaign.runs.metrics import METRICS

    listed = [(cosim, cls) for cls in (*cosim.FAULTS, *cosim.BLOCKS, *METRICS, *EXECUTORS)]
    for classes in (
        controllers.LEARNERS, controllers.LAWS, controllers.CONTROLLERS, controllers.FAULT_MODES, controllers.ACTUATOR_MODES,
    ):  # fmt: skip
        listed += [(controllers, cls) for cls in classes]
    listed += [(monitoring, cls) for cls in monitoring.PLANT_MODELS]
    for home, cls in listed:
        stub = f"{home.__name__.removeprefix('bayesftc.')}/__init__.pyi"
        assert getattr(home, cls.__name__, None) is cls, f"{stub} lacks {cls.__name__} as {cls.__name__}"


def test_every_learner_has_a_row_in_the_page_of_learners():
    text = (ROOT / "docs" / "explanation" / "precision.md").read_text(encoding="utf-8")
    for cls in controllers.LEARNERS:
        assert re.search(rf"^\| `{cls.__name__}\(", text, re.M), (
            f"docs/explanation/precision.md lacks a row for {cls.__name__}"
        )


def test_pages_of_faults_plants_and_executors_have_each_of_them():
    from bayesftc.cosim.campaign.executors.choice import EXECUTORS

    for page, names in (
        ("explanation/concepts.md", [cls.__name__ for cls in cosim.FAULTS]),
        ("reference/plants.md", fmus.names()),
        ("reference/campaigns.md", [f"{cls.__name__}(" for cls in EXECUTORS]),
    ):
        rows = "".join(re.findall(r"^\|.*", (ROOT / "docs" / page).read_text(encoding="utf-8"), re.M))
        for name in names:
            assert f"`{name}" in rows, f"docs/{page} lacks {name} in its table"


def test_every_block_has_a_row_with_its_formula():
    text = (ROOT / "docs" / "reference" / "blocks.md").read_text(encoding="utf-8")
    for cls in cosim.BLOCKS:
        assert re.search(rf"^\|[^|]*`{cls.__name__}`[^|]*\|", text, re.M), (
            f"docs/reference/blocks.md lacks a row for {cls.__name__}"
        )


def test_the_page_of_scenario_files_has_every_section_and_key():
    """The key classes are all dataclasses of the modules of sections, so that a new one cannot be forgotten."""
    from bayesftc.scenario import _blocks, _fmu_files, _linear_plant, _sections
    from bayesftc.scenario._scenario import SECTIONS
    from bayesftc.scenario._schema import settings

    text = (ROOT / "docs" / "reference" / "scenarios.md").read_text(encoding="utf-8")
    for section in SECTIONS:
        assert re.search(rf"^\| `\[+{section}\b", text, re.M), f"docs/reference/scenarios.md lacks [{section}]"
    kinds = {
        value
        for module in (_sections, _blocks, _fmu_files, _linear_plant)
        for value in vars(module).values()
        if is_dataclass(value) and value.__module__ == module.__name__
    } - {_blocks.Surroundings}
    assert len(kinds) >= 6
    keys = {key for kind in (*kinds, cosim.Sensors) for key in settings(kind)} - {"function"}
    keys |= {*_linear_plant.LINEAR, "every", "from", "to"}
    for key in keys:
        assert f"`{key}`" in text or f"`{key} " in text, f"docs/reference/scenarios.md lacks the key {key}"


def test_exit_codes_are_distinct_and_documented():
    from bayesftc.cosim import errors

    kinds = [e for e in vars(errors).values() if inspect.isclass(e) and issubclass(e, errors.BayesFTCError)]
    text = (ROOT / "docs" / "reference" / "command-line.md").read_text(encoding="utf-8")
    assert len({kind.exit_code for kind in kinds}) == len(kinds)
    for kind in kinds:
        assert re.search(rf"^\| {kind.exit_code} \|.*`{kind.__name__}` \|$", text, re.M), kind.__name__


COLUMNS = r"```\{columns\} (\S+)\n:prefix: (\S+)\n:rows: (\S+)\n```"
"""A table of the page of columns of results: its record, the beginning of its columns, and the rows with their labels."""


def test_each_column_of_results_is_defined_on_their_page():
    site = pytest.importorskip("file_keys", exc_type=ImportError)
    text = (ROOT / "docs" / "reference" / "result-columns.md").read_text(encoding="utf-8")
    (module,) = re.findall(r"```\{definitions\} (\S+)\n```", text)
    assert "- a sensor is *blamed while healthy* in" in "\n".join(site.definitions(module))
    lines, labels = [], set()
    for record, prefix, rows in re.findall(COLUMNS, text):
        of_rows = site.labels_of(site.thing(rows))
        lines += site.columns(site.thing(record), prefix, of_rows)
        labels |= set(of_rows.values())
    defined = set(re.findall(r"^\| `(\w+\.\w+\.\w+)` \|", "\n".join(lines), re.MULTILINE))
    loop = load_scenario("cruise_control").loop()
    found = {re.sub(r"^(\w+)\.(\w+)", _general, name) for name in cosim.LoopFigures().columns(loop)}
    assert "sensors.N.faults" in found
    assert found <= defined
    for record in (metrics.Errors, metrics.Detection, metrics.InputFaults, metrics.ActuatorFaults):
        for field in fields(record):
            assert any(f".{field.name}` |" in line or f"| `{field.name}`, only" in line for line in lines), field.name
    assert labels <= {line.split(" | ")[1] for line in lines if " | " in line}


def _general(found):
    """Return the beginning of a column as the page writes it."""
    return {"sensors": "sensors.N", "tracking": "tracking.NAME", "belief": "tracking.NAME"}[found[1]]


def test_every_public_name_has_a_page_of_the_site():
    pages = {module: public_names.page(sys.modules[module]) for module in public_names.MODULES}
    for name, thing in PUBLIC.items():
        if not inspect.ismodule(thing):
            module, short = name.rsplit(".", 1)
            assert f"   ~{module}.{short}\n" in pages[module], f"{name} has no page"


def test_links_out_of_the_pages_lead_to_copies_or_downloads():
    text = (
        "[c](../../CHANGELOG.md#a) [m](../../examples/firmware/main.c) [g](glossary.md) "
        "![f](../figures/a.png)\n```\n[x](y)\n```\n"
    )
    expected = (
        "[c](../project/changelog.md#a) {download}`m <../../examples/firmware/main.c>` [g](glossary.md) "
        "![f](../figures/a.png)\n```\n[x](y)\n```\n"
    )
    assert repository_files.linked(text, "docs/reference/a.md", "docs/reference/a.md") == expected


def test_a_page_of_a_class_describes_the_parameters_of_its_bases():
    inherited = pytest.importorskip("inherited_parameters", exc_type=ImportError)
    for cls in (cosim.Freeze, controllers.Frozen, controllers.Drifting, controllers.LQGController):
        text = inherited.completed(cls, inspect.getdoc(cls))
        entries = inherited.NumpyDocString(text)["Parameters"]
        names = [name for entry in entries for name in entry.name.split(", ")]
        assert sorted(names) == sorted(inspect.signature(cls).parameters)
        assert not any(inherited.refers(entry) for entry in entries)
        assert ("Examples" in text) == (">>>" in text)
    assert inherited.completed(controllers.FaultMode, "As it was.") == "As it was."
