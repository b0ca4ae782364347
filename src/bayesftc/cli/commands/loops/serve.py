"""``bayesftc serve``: a scenario that runs now, with a page to watch it and to break it."""

from __future__ import annotations

from typing import Annotated

import typer

from bayesftc.cli.options import AScenario
from bayesftc.cli.page import HOST, PORT, Host, OpenPage, PagePort, need_console, serve_page


def serve(
    scenario: AScenario,
    host: Host = HOST,
    port: PagePort = PORT,
    beside: Annotated[
        list[str] | None,
        typer.Option(
            help="A precision learner to compare with the scenario's own; repeat the option for a second one. By default "
            "FixedPrecision, without fault tolerance."
        ),
    ] = None,
    alone: Annotated[bool, typer.Option("--alone", help="Run only the scenario's own controller.")] = False,
    open_page: OpenPage = False,
) -> None:
    """Serve the page until Ctrl-C."""
    if alone and beside:
        raise typer.BadParameter("--alone leaves out what --beside adds: leave one of them out.")
    need_console("bayesftc serve")
    from bayesftc.console.desk.desk import Served, check_learners

    learners = () if alone else tuple(beside or ("FixedPrecision",))
    check_learners(learners)
    serve_page(Served.of(scenario), host, port, open_page, learners)
