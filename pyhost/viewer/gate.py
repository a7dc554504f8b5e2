"""Lets in requests that know the address, came to it by its own name, and were sent by no other site's page.

- The address holds a random token; requests without it are refused, and learn nothing.
- ``Host`` must name this machine by a numeric address or as localhost: a name that somebody points here (DNS
  rebinding) is refused, so no browser takes this server for another site.
- ``Origin``, which a browser sends with each WebSocket and each POST and no page can change, must be that of the page
  itself.
"""

from __future__ import annotations

import hmac
import ipaddress
from collections.abc import Iterable
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

CLOSED = "open the whole address that lightdome printed, with what follows its last colon"
# What may hold the page in a frame: a notebook's page on this machine.
NOTEBOOKS = ("http://localhost:*", "http://127.0.0.1:*", "https://localhost:*", "https://127.0.0.1:*")


def headers(frames: Iterable[str] = ()) -> dict[str, str]:
    """What every answer says to the browser: nothing is loaded from, sent to or shown in another site."""
    policy = {
        "default-src": "'none'",
        "script-src": "'self'",
        "style-src": "'self'",
        "img-src": "'self' blob: data:",
        "connect-src": "'self'",
        "base-uri": "'none'",
        "form-action": "'none'",
        "frame-ancestors": " ".join(("'self'", *frames)),
    }
    return {
        "Content-Security-Policy": "; ".join(f"{name} {value}" for name, value in policy.items()),
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cache-Control": "no-store",
    }


class Gate:
    """Stands before an application, and hands on what may pass with the token taken off its path."""

    def __init__(self, app: ASGIApp, token: str, hosts: Iterable[str] = (), frames: Iterable[str] = ()) -> None:
        self.app, self.token, self.hosts = app, token.encode(), {"localhost", *(host.lower() for host in hosts)}
        self.headers = [(name.lower().encode(), value.encode()) for name, value in headers(frames).items()]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        refusal = self._refusal(scope)
        is_page = scope["type"] == "http"

        async def send_safely(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *self.headers]
            await send(message)

        if refusal is None:
            path = "/" + scope["path"].split("/", 2)[2]
            await self.app({**scope, "path": path, "raw_path": path.encode()}, receive, send_safely)
        elif is_page:
            await PlainTextResponse(refusal, 403)(scope, receive, send_safely)
        else:
            await send({"type": "websocket.close", "code": 1008})  # before it is accepted: the answer is 403

    def _refusal(self, scope: Scope) -> str | None:
        of_request = Headers(scope=scope)
        if len(of_request.getlist("host")) != 1 or not self._is_here(of_request["host"]):
            return "this server has no such name"
        origins = of_request.getlist("origin")
        must_say = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if any(origin != f"http://{of_request['host']}" for origin in origins) or (must_say and len(origins) != 1):
            return "only its own page may ask this server"
        parts = scope["path"].split("/", 2)
        if not (len(parts) == 3 and hmac.compare_digest(parts[1].encode(errors="replace"), self.token)):
            return CLOSED
        return None

    def _is_here(self, host: str) -> bool:
        """Whether ``Host`` is an address of numbers, localhost, or a name that was given on the command line."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if name in self.hosts:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True
