"""``bayesftc report``: a stored campaign to one page."""

from __future__ import annotations

from pathlib import Path

import typer

from bayesftc.cli import output


def write_report(
    store: Path, out: Path | None, *, metric: str | None, compare: str | None, title: str | None, quiet: bool
) -> None:
    """Write the report of a campaign, whole or not at all.

    Parameters
    ----------
    store : pathlib.Path
        Folder of the campaign.
    out : pathlib.Path or None
        The page; by default ``report.html`` in the folder.
    metric, compare, title : str or None
        See `bayesftc.report.page.report`.
    quiet : bool
        Say nothing.
    """
    from bayesftc.cosim.campaign.store.folder import CampaignStore
    from bayesftc.report.page import report

    target = store / "report.html" if out is None else out
    opened = CampaignStore.open(store)
    output.check_folder(target.parent, [target.name])
    page = report(opened, metric=metric, compare=compare, title=title)
    with output.staged(target.parent) as stage:
        (stage / target.name).write_text(page, encoding="utf-8")
    if not quiet:
        typer.echo(f"{target}: open it in a browser.")
