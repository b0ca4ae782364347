"""``bayesftc serve``: a scenario that runs now, with a page to watch it and to break it."""

from __future__ import annotations

from typing import Annotated

import typer

from bayesftc.cli.options import AScenario
from bayesftc.cosim.base.extras import why_missing
from bayesftc.cosim.errors import BayesFTCError


def serve(
    scenario: AScenario,
    host: Annotated[
        str, typer.Option(help="Address to listen on. Any other than this machine's own needs the printed token.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port to listen on; 0 for a free one.", min=0, max=65535)] = 8765,
    beside: Annotated[
        list[str] | None,
        typer.Option(
            help="A precision learner to compare with the scenario's own; repeat the option for a second one. By default "
            "FixedPrecision, without fault tolerance."
        ),
    ] = None,
    alone: Annotated[bool, typer.Option("--alone", help="Run only the scenario's own controller.")] = False,
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
) -> None:
    """Serve the page until Ctrl-C."""
    if missing := why_missing("starlette", "uvicorn", "websockets", purpose="bayesftc serve", of="console"):
        raise BayesFTCError(missing)
    if alone and beside:
        raise typer.BadParameter("--alone leaves out what --beside adds: leave one of them out.")
    from bayesftc.console.web.serving import serve_scenario

    learners = () if alone else tuple(beside or ("FixedPrecision",))
    serve_scenario(scenario, host, port, learners, say=lambda text: typer.echo(text, err=True), open_page=open_page)
