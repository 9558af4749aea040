"""The server of the page: on this machine only, behind a random token."""

from __future__ import annotations

import hmac
import secrets
import socket
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

from ...common.lazy import require

HOST = "127.0.0.1"
# Bytes of the token: too many to be guessed.
TOKEN_BYTES = 24
# The largest file that is taken.
MAX_FILE_BYTES = 2_000_000_000

# The protocol of Python's servers (ASGI).
Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]


class Guard:
    """Lets in who has the token, by the address once and then by a cookie.

    Requests by another name of this machine are refused, too: a page of the web that
    points its own name at 127.0.0.1 has no way in.

    Parameters
    ----------
    application : callable
        What is guarded.
    token : str
    port : int
    """

    def __init__(self, application: Application, token: str, port: int) -> None:
        self._application = application
        self._token = token
        self._hosts = {f"{HOST}:{port}", f"localhost:{port}"}
        self._cookie = f"pysindy_nrf_{port}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._application(scope, receive, send)
            return
        headers = {key.decode("latin-1"): value for key, value in scope["headers"]}
        query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
        by_address = self._is_token(query.get("token", [""])[0])
        known = by_address or self._is_token(self._cookie_of(headers))
        if not known or headers.get("host", b"").decode("latin-1") not in self._hosts:
            await _refuse(scope, receive, send)
            return

        async def send_with_cookie(message: MutableMapping[str, Any]) -> None:
            if by_address and message["type"] == "http.response.start":
                words = (
                    f"{self._cookie}={self._token}; HttpOnly; SameSite=Strict; Path=/"
                )
                cookie = (b"set-cookie", words.encode())
                message["headers"] = [*message.get("headers", []), cookie]
            await send(message)

        await self._application(scope, receive, send_with_cookie)

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(), self._token.encode())

    def _cookie_of(self, headers: MutableMapping[str, bytes]) -> str:
        cookies: SimpleCookie = SimpleCookie()
        try:
            cookies.load(headers.get("cookie", b"").decode("latin-1"))
        except CookieError:
            return ""
        morsel = cookies.get(self._cookie)
        return "" if morsel is None else morsel.value


async def _refuse(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer that the token is missing."""
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008})
        return
    body = b"Open the address that pysindy-nrf app has printed, with its token."
    headers = [(b"content-type", b"text/plain; charset=utf-8")]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": body})


def free_port() -> int:
    """A port that nothing listens on."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def serve(port: int, opened: bool, announce: Callable[[str], object]) -> None:
    """Serve the page until Ctrl-C.

    Parameters
    ----------
    port : int
        A free one if 0.
    opened : bool
        Whether a browser is opened.
    announce : callable
        Is given the address, with the token.

    Raises
    ------
    MissingExtraError
        Without NiceGUI, which the extra ``app`` brings.
    """
    nicegui = require("nicegui", "app", "The application")
    from .page import build

    port = port or free_port()
    token = secrets.token_urlsafe(TOKEN_BYTES)
    build(nicegui)
    nicegui.app.add_middleware(Guard, token=token, port=port)
    path = f"/?token={token}"
    nicegui.app.on_startup(lambda: announce(f"http://{HOST}:{port}{path}"))
    nicegui.ui.run(
        host=HOST,
        port=port,
        title="pysindy_nrf",
        dark=None,
        show=path if opened else False,
        reload=False,
        tailwind=False,
        show_welcome_message=False,
    )
