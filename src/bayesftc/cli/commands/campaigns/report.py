"""``bayesftc report``: a page about a stored campaign."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayesftc.cli import output
from bayesftc.cli.options import Quiet, Store
from bayesftc.cosim.base.announcing import reported


def report(
    store: Store,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE", help="The page; by default report.html in the folder.")
    ] = None,
    metric: Annotated[str | None, typer.Option(help="The metric that counts; by default the first.")] = None,
    compare: Annotated[
        str | None,
        typer.Option(
            metavar="FACTOR",
            help="The factor whose levels are compared, as controller.precision. By default the learner or the controller, else "
            "the first factor with names, else the first one.",
        ),
    ] = None,
    title: Annotated[
        str | None, typer.Option(help="Title, such as the question of the campaign; by default the folder's name.")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Write the report of a campaign; after an error no partial file remains."""
    from bayesftc.cosim.campaign.store.folder import CampaignStore
    from bayesftc.report import page

    target = store / "report.html" if out is None else out
    opened = CampaignStore.open(store)
    output.check_folder(target.parent, [target.name], silent=quiet)
    with reported("Drawing the report, for some seconds."):
        text = page.report(opened, metric=metric, compare=compare, title=title)
    with output.staged(target.parent) as stage:
        (stage / target.name).write_text(text, encoding="utf-8")
    if not quiet:
        typer.echo(f"{target}: open it in a browser.")
