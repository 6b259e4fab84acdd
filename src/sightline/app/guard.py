"""Guard of the page's server: hosts, tokens, headers, sizes."""

import re
import secrets
from http.cookies import CookieError, SimpleCookie
from typing import Final
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOOPBACK: Final = ("127.0.0.1", "localhost", "[::1]")
HEADERS: Final = {
    "Content-Security-Policy": (
        "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Headers of every answer."""

_HOST: Final = re.compile(r"(\[[^\]]*\]|[^:]*)(?::\d*)?")  # and its port
_MAX_TARGET: Final = 8000


class Guard:
    """Middleware that lets only this machine's pages, or those with the token, ask for data."""

    def __init__(self, app: ASGIApp, *, hosts: tuple[str, ...], token: str | None = None) -> None:
        """Store the names by which a server without a token may be called, and the token."""
        self._app, self._hosts, self._token = app, hosts, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer or refuse a request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers[name] = value
            await send(message)

        refusal = self._refusal(scope)
        await (refusal or self._app)(scope, receive, send_guarded)

    def _refusal(self, scope: Scope) -> Response | None:
        headers = Headers(scope=scope)
        host = headers.get("host", "").lower()
        named = _HOST.fullmatch(host)
        name = host if named is None else named[1]
        # Another site's page that has rebound its name to this address has no token's cookie.
        if self._token is None and name not in self._hosts:
            return _refused(421, "this server is not called so; open the address that it prints")
        if scope["method"] not in ("GET", "HEAD"):
            return _refused(405, "this server only answers")
        if len(scope["raw_path"]) + len(scope["query_string"]) > _MAX_TARGET:
            return _refused(414, f"the address has more than {_MAX_TARGET} characters; shorten it")
        is_page = scope["path"] == "/"
        if not is_page and headers.get("sec-fetch-site", "same-origin") not in (
            "same-origin",
            "none",
        ):
            return _refused(403, "another site's page asks; open the address that serve prints")
        return self._refuse_without_token(scope, headers)

    def _refuse_without_token(self, scope: Scope, headers: Headers) -> Response | None:
        if self._token is None:
            return None
        query = parse_qs(scope["query_string"].decode("latin-1"))  # _MAX_TARGET bounds it
        given = query.get("token", [""])[0]
        if scope["path"] == "/" and self._is_token(given):
            answer = RedirectResponse("/", 303)
            answer.set_cookie(_cookie(scope), self._token, httponly=True, samesite="strict")
            return answer
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(_cookie(scope))
        except CookieError:
            cookie = None
        if cookie is None or not self._is_token(cookie.value):
            return _refused(403, "the token is missing; open the whole address that serve prints")
        return None

    def _is_token(self, given: str) -> bool:
        assert self._token is not None, "asked only where there is one"
        return secrets.compare_digest(given.encode(), self._token.encode())


def _cookie(scope: Scope) -> str:
    """Name of the token's cookie: browsers do not keep those of several ports apart."""
    server = scope.get("server") or ("", 0)
    return f"sightline-{server[1]}"


def _refused(status: int, reason: str) -> Response:
    return PlainTextResponse(f"{reason}\n", status)
