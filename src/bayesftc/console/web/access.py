"""Who may see and move the console: hosts, origins, a token; and the headers of every answer."""

from __future__ import annotations

import hmac
import secrets
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from math import inf
from typing import Any
from urllib.parse import parse_qs

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = (
    (b"content-security-policy", POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)

SOON = 60.0
"""Seconds in which a browser must use its pass: some take long to start."""

Names = Iterable[tuple[bytes, bytes]]


def new_token() -> str:
    """Return a token that nobody can guess."""
    return secrets.token_urlsafe(32)


@dataclass(frozen=True)
class Access:
    """The rules of one server.

    Attributes
    ----------
    host : str
        The address that the server listens on.
    port : int
        Its port.
    token : str or None
        What a browser must know; None on a loopback address.
    once : Once
        Passes for a browser that this process opens: its address is in the list of processes, where the token must not be.
    """

    host: str
    port: int
    token: str | None
    once: Once = field(default_factory=lambda: Once())

    @property
    def cookie(self) -> str:
        """The name of the cookie with the token. Cookies of all ports of a host are shared, so the name has the port."""
        return f"bayesftc-{self.port}"

    def address(self, query: str = "") -> str:
        """Return the address of the page."""
        return f"http://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}/{query}"

    def address_to_open(self) -> str:
        """Return an address of the page that a browser can use once, and soon."""
        return self.address("" if self.token is None else f"?once={self.once.issue()}")

    def lets_in(self, query: Mapping[str, str]) -> bool | None:
        """Return whether the query of an address has the token or a pass; None if it has neither. A pass is used up."""
        if "once" in query:
            return self.once.redeem(query["once"])
        return self.is_token(query["token"]) if "token" in query else None

    def knows_host(self, headers: Names) -> bool:
        """Return whether the request names this server: a page of another name must not reach it (DNS rebinding)."""
        host = _one(headers, b"host")
        if host is None:
            return False
        if self.token is not None:  # any name of this machine is right; the token decides
            return True
        shown = f"[{self.host}]" if ":" in self.host else self.host
        names = {f"{name}:{self.port}" for name in ("127.0.0.1", "localhost", "[::1]", shown)}
        return host in names or (self.port == 80 and f"{host}:80" in names)

    def knows_origin(self, headers: Names) -> bool:
        """Return whether the request comes from a page of this server."""
        origin, host = _one(headers, b"origin"), _one(headers, b"host")
        return origin is not None and host is not None and origin in (f"http://{host}", f"https://{host}")

    def is_token(self, given: str | None) -> bool:
        """Return whether this is the token, in a time that does not depend on where it differs."""
        return self.token is None or hmac.compare_digest((given or "").encode(), self.token.encode())

    def has_token(self, headers: Names) -> bool:
        """Return whether the request's cookie has the token."""
        if self.token is None:
            return True
        try:
            cookies: SimpleCookie = SimpleCookie(_one(headers, b"cookie") or "")
        except CookieError:
            return False
        found = cookies.get(self.cookie)
        return self.is_token(None if found is None else found.value)


class Once:
    """Passes that count once, for a short time.

    Parameters
    ----------
    clock : callable
        The clock in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._until: dict[str, float] = {}

    def issue(self) -> str:
        """Return a new pass."""
        given = new_token()
        self._until[given] = self._clock() + SOON
        return given

    def redeem(self, given: str) -> bool:
        """Return whether a pass still counts; from now on it does not."""
        return self._until.pop(given, -inf) > self._clock()


def _one(headers: Names, name: bytes) -> str | None:
    """Return the value of a header that occurs once; None otherwise."""
    values = [value for key, value in headers if key.lower() == name]
    return values[0].decode("latin-1") if len(values) == 1 else None


class Guard:
    """Answers requests that may not pass, and adds the headers to all other answers."""

    def __init__(self, app: Any, access: Access):
        self._app, self._access = app, access

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Serve one request or connection."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers, access = scope["headers"], self._access
        # A page opens with the token in its address, and goes on with the cookie.
        query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
        opens = scope["type"] == "http" and scope["path"] == "/" and ("token" in query or "once" in query)
        refused = (
            "This server has another name."
            if not access.knows_host(headers)
            else "Open the address with the token that bayesftc serve has printed."
            if not (access.has_token(headers) or opens)
            else "Only the console's own page may connect."
            if scope["type"] == "websocket" and not access.knows_origin(headers)
            else "Only the console's own page may load this."
            if scope["path"] != "/" and _one(headers, b"sec-fetch-site") in ("cross-site", "same-site")
            else "There is nothing to send here."
            if scope["type"] == "http" and scope["method"] not in ("GET", "HEAD")
            else ""
        )
        if refused:
            await self._refuse(scope, receive, send, refused)
            return

        async def with_headers(message: Any) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *HEADERS]
            await send(message)

        await self._app(scope, receive, with_headers)

    async def _refuse(self, scope: Any, receive: Any, send: Any, sentence: str) -> None:
        if scope["type"] == "websocket":
            await receive()
            await send(
                {"type": "websocket.close", "code": 1008, "reason": sentence}
            )  # before it is accepted: status 403
            return
        headers = [(b"content-type", b"text/plain; charset=utf-8"), *HEADERS]
        await send({"type": "http.response.start", "status": 403, "headers": headers})
        await send({"type": "http.response.body", "body": sentence.encode()})


__all__ = ["Access", "Guard", "Once", "new_token"]
