"""The options and the start of commands that serve the page of the console."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from bayesftc.cosim.base.extras import why_missing
from bayesftc.cosim.errors import BayesFTCError

if TYPE_CHECKING:
    from bayesftc.console.desk.desk import Served
    from bayesftc.console.desk.live import LiveRun

Host = Annotated[
    str, typer.Option(help="Address of the page. Any other than this machine's own needs the printed token.")
]
PagePort = Annotated[int, typer.Option("--port", help="Port of the page; 0 for a free one.", min=0, max=65535)]
OpenPage = Annotated[bool, typer.Option("--open", help="Open the page in the browser.")]
Beside = Annotated[bool, typer.Option("--serve", help="Show the run on a page, as bayesftc serve.")]
Drops = Annotated[
    bool,
    typer.Option("--drops", help="Let the operator of the page drop samples of wires, for tests of your own plant."),
]
HOST, PORT = "127.0.0.1", 8765


@dataclass(frozen=True)
class PageBeside:
    """The options of a page beside a live run."""

    serve: bool
    drops: bool
    host: str
    port: int
    open_page: bool

    def check(self, command: str) -> None:
        """Refuse what does not fit together.

        Raises
        ------
        BadParameter, BayesFTCError
            If that is so, or the extra ``console`` is missing.
        """
        if self.serve:
            need_console(f"{command} --serve")
        elif self.drops:
            raise typer.BadParameter("--drops is for the operator of a page: add --serve.")


def need_console(command: str) -> None:
    """Refuse a command without the extra ``console``.

    Raises
    ------
    BayesFTCError
        If a package is not installed.
    """
    if missing := why_missing("starlette", "uvicorn", "websockets", purpose=command, of="console"):
        raise BayesFTCError(missing)


def serve_page(served: Served, host: str, port: int, open_page: bool, beside: Sequence[str] = ()) -> None:
    """Serve the page of a scenario until Ctrl-C.

    Raises
    ------
    BayesFTCError
        If the address cannot be used.
    """
    from bayesftc.console.web.serving import Where, serve

    serve(served, beside, Where(host, port, open_page), lambda text: typer.echo(text, err=True))


def page_beside(run: LiveRun, options: PageBeside) -> AbstractContextManager[None]:
    """Return the context in which the page of a live run is served.

    Raises
    ------
    BayesFTCError
        If the address cannot be used.
    """
    from bayesftc.console.web.serving import Where, shown_beside

    where = Where(options.host, options.port, options.open_page)
    return shown_beside(run, where, lambda text: typer.echo(text, err=True))


__all__ = [
    "HOST",
    "PORT",
    "Beside",
    "Drops",
    "Host",
    "OpenPage",
    "PageBeside",
    "PagePort",
    "need_console",
    "page_beside",
    "serve_page",
]
