"""Who may open the page: only this machine, or whoever has the token."""

from __future__ import annotations

import ipaddress
import secrets
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

_FORBIDDEN: Final = b"403: open the URL that `shape-obs tune` printed; it contains a token.\n"
_POLICY_VIOLATION: Final = 1008


class Guard:
    """An ASGI application in front of another one, which refuses what has no right to it with 403.

    Without a token only requests for this machine's own name pass, so that a page on the internet whose name leads here
    cannot use the browser to reach the tuner. With a token every request must have it: in its query, or in the cookie
    that the first answer sets. Websockets from pages of another origin are refused either way.

    Args:
        app: The application behind it.
        token: The token; None for a server that only this machine can reach.
        port: The server's port, part of the cookie's name.
    """

    def __init__(self, app: App, token: str | None, port: int) -> None:
        self.app, self._token, self._cookie = app, token, f"shape_obs_tune_{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        by_query = self._has_token(parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", ()))
        if not self._may_pass(headers, by_query):
            await _refuse(scope, send)
            return

        async def with_cookie(message: Message) -> None:
            if by_query and message["type"] == "http.response.start":
                cookie = f"{self._cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/"
                message["headers"] = [*message.get("headers", ()), (b"set-cookie", cookie.encode())]
            await send(message)

        await self.app(scope, receive, with_cookie)

    def _may_pass(self, headers: dict[str, str], by_query: bool) -> bool:
        host, origin = headers.get("host", ""), headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return False
        if self._token is None:
            return is_local(urlsplit(f"//{host}").hostname or "")
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(self._cookie)
        except CookieError:
            cookie = None
        return by_query or (cookie is not None and self._has_token([cookie.value]))

    def _has_token(self, given: Iterable[str]) -> bool:
        token = self._token
        return token is not None and any(secrets.compare_digest(each.encode(), token.encode()) for each in given)


def is_local(host: str) -> bool:
    """Return whether only this machine can reach a host name or address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


async def _refuse(scope: Scope, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": _POLICY_VIOLATION})  # before it is accepted: the answer is 403
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"content-length", str(len(_FORBIDDEN)).encode())]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": _FORBIDDEN})
