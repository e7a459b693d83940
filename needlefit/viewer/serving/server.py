"""The local server: the page, its WebSocket, and files to download."""

import asyncio
import socket
from collections.abc import Awaitable, Callable
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from needlefit.errors import ConfigError, NeedlefitError
from needlefit.viewer.export import EXPORT_TYPES, export
from needlefit.viewer.overlay.slice import read_slice
from needlefit.viewer.serving.connections import (
    HEADERS,
    LOOPBACK,
    MAX_MESSAGE_BYTES,
    AccessControl,
    Connections,
)
from needlefit.viewer.serving.trials import InteractiveTrial, TrialRegistry


class FileRoutes:
    """Creates files during a simulation: exports in a separate process, slices in a thread."""

    def __init__(self, trials: TrialRegistry) -> None:
        self.trials = trials
        self._pool: ProcessPoolExecutor | None = None

    async def make(self, request: web.Request) -> web.Response:
        """Return a file made from a recording, by a process of its own: frames go on meanwhile."""
        kind = request.match_info["kind"]
        trial = await self._asked(request)
        if kind not in EXPORT_TYPES:
            raise web.HTTPNotFound(text=f"there is no export {kind}; there are {', '.join(EXPORT_TYPES)}")
        # spawn: a forked child would share the server's sockets and its threads' locks. The pool starts with
        # the first export, so that a server without exports pays nothing.
        self._pool = self._pool or ProcessPoolExecutor(1, mp_context=get_context("spawn"))
        try:
            trial.recorder.begin()
            found = await asyncio.get_running_loop().run_in_executor(
                self._pool, export, trial.recorder.path, kind
            )
        except (NeedlefitError, OSError) as error:
            raise web.HTTPUnprocessableEntity(text=str(error)) from error
        except BrokenExecutor as error:
            self._pool = None  # it was killed, perhaps for want of memory; the next one begins anew
            raise web.HTTPInternalServerError(text="the program that made it was ended; try again") from error
        return web.Response(body=found, content_type=EXPORT_TYPES[kind])

    async def cut(self, request: web.Request) -> web.Response:
        """Return the scan's slice in the bending plane."""
        scanned = (await self._asked(request)).viewed_scene.scanned
        if scanned is None:
            raise web.HTTPNotFound(text="there is no scan of this insertion")
        try:
            found = await asyncio.to_thread(read_slice, scanned)
        except (NeedlefitError, OSError) as error:
            raise web.HTTPUnprocessableEntity(text=str(error)) from error
        extent = ",".join(f"{edge:.4f}" for edge in found.extent)
        return web.Response(body=found.png, content_type="image/png", headers={"X-Extent-Mm": extent})

    async def leave(self, _: web.Application) -> None:
        """Wait for nothing that is still being made."""
        if self._pool:
            self._pool.shutdown(wait=False, cancel_futures=True)

    async def _asked(self, request: web.Request) -> InteractiveTrial:
        """Return the trial that a request is about."""
        try:
            content = await request.json()
            trial = self.trials.known(content["needle"])
        except (ValueError, LookupError, TypeError):  # no JSON, of no known charset, or about no needle
            trial = None
        if trial is None:
            raise web.HTTPNotFound(text="there is no such needle: reload the page")
        return trial


PAGE = Path(__file__).parent.parent / "page"


async def serve(
    trials: TrialRegistry,
    port: int,
    ready: Callable[[AccessControl], None],
    stop: Callable[[], Awaitable[None]],
) -> None:
    """Serve on the loopback until `stop` returns.

    Parameters
    ----------
    trials : TrialRegistry
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
    runner = web.AppRunner(_application(access, trials), access_log=None, shutdown_timeout=2.0)
    await runner.setup()
    try:
        await web.SockSite(runner, listening).start()
        ready(access)
        await stop()
    finally:
        await runner.cleanup()


def _application(access: AccessControl, trials: TrialRegistry) -> web.Application:
    """Return the routes."""
    connections, files = Connections(access, trials), FileRoutes(trials)
    app = web.Application(middlewares=[_make_guard(access)], client_max_size=MAX_MESSAGE_BYTES)
    app.router.add_get("/", _index)
    app.router.add_get("/ws", connections.attend)
    app.router.add_post("/export/{kind}", files.make)
    app.router.add_post("/slice", files.cut)
    app.router.add_static("/page", PAGE)
    app.on_response_prepare.append(_add_headers)
    app.on_shutdown.extend((connections.leave, files.leave))
    return app


def _make_guard(access: AccessControl) -> Middleware:
    """Return what keeps out who calls this server by another name, and who has no token where one is due."""

    @web.middleware
    async def guard(request: web.Request, handler: Handler) -> web.StreamResponse:
        if not access.has_own_host(request.headers):
            raise web.HTTPMisdirectedRequest(text="this server answers to 127.0.0.1 and localhost alone")
        if request.method == "POST":
            scheme, _, token = request.headers.get("Authorization", "").partition(" ")
            if scheme != "Bearer" or not access.is_token(token):
                raise web.HTTPForbidden(text="the token is missing or wrong: open the address as printed")
        if (request.method == "POST" or request.path == "/ws") and not access.from_page(request.headers):
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
            fix="leave --port out: a free one is then taken",
        ) from error


async def _add_headers(_: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(HEADERS)


async def _index(_: web.Request) -> web.FileResponse:
    return web.FileResponse(PAGE / "index.html")
