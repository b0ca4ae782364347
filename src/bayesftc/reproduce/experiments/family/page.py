"""Write the family into a page.

python -m bayesftc.reproduce.experiments.family.page results/family.json docs/explanation/which-learner.md
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bayesftc.reproduce.experiments.family.groups import Figures, by_group, figures, ratio_of
from bayesftc.reproduce.experiments.family.tables import shown_ratio
from bayesftc.reproduce.shared.tables import sentence_list

BEGIN, END = "<!-- family -->", "<!-- end of family -->"
BAR = 1.10
"""The ratio above which the page lists a case of the default learner."""


def results(report: Mapping[str, Any]) -> str:
    """Return the text for a page: a row for each learner, a column for each group, and the losses of the first learner."""
    groups, table, settings = by_group(report), report["table"], report["settings"]
    sizes = {group: sum(of == group for of in report["groups"].values()) for group in groups}
    heads = [f"all ({len(table)})", *(f"{group} ({sizes[group]})" for group in groups), "blamed while healthy"]
    rows = [f"| learner | {' | '.join(heads)} |", "|---" * (1 + len(heads)) + "|"]
    for name in report["summary"]:
        whole = figures([of[name] for of in table.values()])
        share = "" if whole.false_share is None else f"{100 * whole.false_share:.2f} %"
        cells = [_cell(whole), *(_cell(of[name]) for of in groups.values()), share]
        rows.append(f"| `{name}` | {' | '.join(cells)} |")
    heading = f"{settings['runs']} runs of each of {len(table)} cases, seed {settings['seed']}."
    return "\n".join([heading, "", *rows, "", _losses(table, next(iter(report["summary"])))])


def _cell(of: Figures) -> str:
    return f"{of.lost} runs lost" if of.lost else f"{of.mean:.2f} / {shown_ratio(of.worst)}"


def _losses(table: Mapping[str, Mapping[str, Any]], name: str) -> str:
    """Return a sentence with the cases in which a learner is above the bar, and the best learner of each."""
    bad = sorted(
        (case for case, of in table.items() if ratio_of(of[name]) > BAR), key=lambda case: -ratio_of(table[case][name])
    )
    if not bad:
        return f"`{name}` is above {BAR:.2f} in no case."
    losses = sentence_list([_loss(case, table[case], name) for case in bad])
    return f"`{name}` is above {BAR:.2f} in {len(bad)} of {len(table)} cases: {losses}."


def _loss(case: str, of: Mapping[str, Any], name: str) -> str:
    best = min(of, key=lambda other: ratio_of(of[other]))
    return f'{ratio_of(of[name]):.2f} in "{case}" (best: `{best}` {ratio_of(of[best]):.2f})'


def rewritten(page: str, report: Mapping[str, Any]) -> str:
    """Return a page with the results of a report between its two marks."""
    before, _, rest = page.partition(BEGIN)
    _, mark, after = rest.partition(END)
    if not mark:
        raise SystemExit(f"The page lacks the lines {BEGIN!r} and {END!r}, between which the results belong. Add them.")
    return f"{before}{BEGIN}\n{results(report)}\n{END}{after}"


def main(arguments: Sequence[str]) -> None:
    """Rewrite a page."""
    if len(arguments) != 2:
        raise SystemExit("Give the file family.json from bayesftc reproduce family --out, and the page.")
    report, page = Path(arguments[0]), Path(arguments[1])
    text = rewritten(page.read_text(encoding="utf-8"), json.loads(report.read_text(encoding="utf-8")))
    page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
