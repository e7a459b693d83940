"""The local server: the page, a line to each window, and files to take away."""

import socket
from collections.abc import Awaitable, Callable
from pathlib import Path

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from needlefit.errors import ConfigError
from needlefit.viewer.serving.door import HEADERS, LARGEST, LOOPBACK, Door
from needlefit.viewer.serving.files import Files
from needlefit.viewer.serving.lines import Lines
from needlefit.viewer.serving.trials import Trials

PAGE = Path(__file__).parent.parent / "page"


async def serve(
    trials: Trials, port: int, ready: Callable[[Door], None], stop: Callable[[], Awaitable[None]]
) -> None:
    """Serve on the loopback until `stop` returns.

    Parameters
    ----------
    trials : Trials
    port : int
        0: one that is free.
    ready : callable
        Told the door once the page can be opened.
    stop : callable
        Awaited while pages are served.

    Raises
    ------
    ConfigError
        If the port is taken.
    """
    listening = _listen(port)
    door = Door(listening.getsockname()[1])
    runner = web.AppRunner(_application(door, trials), access_log=None, shutdown_timeout=2.0)
    await runner.setup()
    try:
        await web.SockSite(runner, listening).start()
        ready(door)
        await stop()
    finally:
        await runner.cleanup()


def _application(door: Door, trials: Trials) -> web.Application:
    """Return the routes."""
    lines, files = Lines(door, trials), Files(trials)
    app = web.Application(middlewares=[_guarding(door)], client_max_size=LARGEST)
    app.router.add_get("/", _index)
    app.router.add_get("/ws", lines.attend)
    app.router.add_post("/export/{kind}", files.make)
    app.router.add_post("/slice", files.cut)
    app.router.add_static("/page", PAGE)
    app.on_response_prepare.append(_sealed)
    app.on_shutdown.extend((lines.leave, files.leave))
    return app


def _guarding(door: Door) -> Middleware:
    """Return what keeps out who calls this server by another name, and who has no token where one is due."""

    @web.middleware
    async def guard(request: web.Request, handler: Handler) -> web.StreamResponse:
        if not door.at_home(request.headers):
            raise web.HTTPMisdirectedRequest(text="this server answers to 127.0.0.1 and localhost alone")
        if request.method == "POST":
            scheme, _, token = request.headers.get("Authorization", "").partition(" ")
            if scheme != "Bearer" or not door.knows(token):
                raise web.HTTPForbidden(text="the token is missing or wrong: open the address as printed")
        if (request.method == "POST" or request.path == "/ws") and not door.from_page(request.headers):
            raise web.HTTPForbidden(text="only the page that this server gave out may ask for that")
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
            mend="leave --port out: a free one is then taken",
        ) from error


async def _sealed(_: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(HEADERS)


async def _index(_: web.Request) -> web.FileResponse:
    return web.FileResponse(PAGE / "index.html")
