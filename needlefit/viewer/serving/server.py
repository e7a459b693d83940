"""The local server of a page: its files, its access control, and the routes that a page adds."""

import asyncio
import socket
from collections.abc import Awaitable, Callable
from pathlib import Path
from time import monotonic
from typing import Protocol

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware
from aiohttp.web_protocol import RequestHandler

from needlefit.errors import ConfigError
from needlefit.viewer.serving.connections import HEADERS, LOOPBACK, MAX_MESSAGE_BYTES, AccessControl

PAGE = Path(__file__).parent.parent / "page"

REQUEST_TIMEOUT_S, CHECK_INTERVAL_S = 10.0, 1.0
"""Time in which a request must have come whole, s, and pause between two looks at the connections."""

_SPOKEN: web.AppKey[set[RequestHandler]] = web.AppKey("spoken", set)
"""Connections that have sent a whole request."""


class ServedPage(Protocol):
    """A page: its file in `page/`, and what adds the routes that it asks for."""

    index: str

    def add_routes(self, app: web.Application, access: AccessControl) -> None:
        """Add the page's own routes to its server."""


async def serve(
    page: ServedPage,
    port: int,
    ready: Callable[[AccessControl], None],
    stop: Callable[[], Awaitable[None]],
) -> None:
    """Serve on the loopback until `stop` returns.

    Parameters
    ----------
    page : ServedPage
    port : int
        0: one that is free.
    ready : callable
        Called with the access control once the page can be opened.
    stop : callable
        Awaited while pages are served.

    Raises
    ------
    ConfigError
        If the port is taken.
    """
    # The socket is opened before the address is made: port 0 gets its number only then.
    listening = _listen(port)
    access = AccessControl(listening.getsockname()[1])
    app = _application(access, page)
    runner = web.AppRunner(app, access_log=None, shutdown_timeout=2.0, keepalive_timeout=REQUEST_TIMEOUT_S)
    closing = None
    try:
        await runner.setup()
        await web.SockSite(runner, listening).start()
        closing = asyncio.create_task(_close_silent(runner, app))
        ready(access)
        await stop()
    finally:
        if closing is not None:
            closing.cancel()
        await runner.cleanup()
        listening.close()  # also where the setup failed before anything was served


async def _close_silent(runner: web.AppRunner, app: web.Application) -> None:
    """Close connections that have not sent the headers of a first request in time: they hold a place."""
    since: dict[RequestHandler, float] = {}
    while True:
        await asyncio.sleep(CHECK_INTERVAL_S)
        assert runner.server is not None
        here, now = set(runner.server.connections), monotonic()
        since = {one: since.get(one, now) for one in here}
        app[_SPOKEN].intersection_update(here)
        for one, began in since.items():
            if one not in app[_SPOKEN] and now - began > REQUEST_TIMEOUT_S:
                one.force_close()


def _application(access: AccessControl, page: ServedPage) -> web.Application:
    """Return the routes of every page, and those of this one."""

    async def send_index(_: web.Request) -> web.FileResponse:
        return web.FileResponse(PAGE / page.index)

    app = web.Application(middlewares=[_make_guard(access)], client_max_size=MAX_MESSAGE_BYTES)
    app[_SPOKEN] = set()
    app.router.add_get("/", send_index)
    app.router.add_static("/page", PAGE)
    app.on_response_prepare.append(_add_headers)
    page.add_routes(app, access)
    return app


def _make_guard(access: AccessControl) -> Middleware:
    """Return what keeps out who calls this server by another name, and who has no token where one is due."""

    @web.middleware
    async def guard(request: web.Request, handler: Handler) -> web.StreamResponse:
        request.app[_SPOKEN].add(request.protocol)
        if not access.has_own_host(request.headers):
            raise web.HTTPMisdirectedRequest(text="this server answers to 127.0.0.1 and localhost alone")
        if request.method == "POST":
            scheme, _, token = request.headers.get("Authorization", "").partition(" ")
            if scheme != "Bearer" or not access.is_token(token):
                raise web.HTTPForbidden(text="the token is missing or wrong: open the address as printed")
        if (request.method == "POST" or request.path == "/ws") and not access.from_page(request.headers):
            raise web.HTTPForbidden(text="only the page that this server gave out may ask for that")
        try:
            async with asyncio.timeout(REQUEST_TIMEOUT_S):
                await request.read()  # kept for the handler
        except TimeoutError:
            raise web.HTTPRequestTimeout(text="the request was not sent to its end") from None
        return await handler(request)

    return guard


def _listen(port: int) -> socket.socket:
    try:
        return socket.create_server((LOOPBACK, port))
    except (OSError, OverflowError) as error:
        raise ConfigError(
            f"port {port} cannot be used: {getattr(error, 'strerror', error)}",
            where="--port",
            expected="a free port from 1024 to 65535",
            fix="leave --port out: a free one is then taken",
        ) from error


async def _add_headers(_: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(HEADERS)
