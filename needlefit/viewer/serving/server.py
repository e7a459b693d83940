"""The local server: the page, a socket for each window, and files to take away."""

import asyncio
import json
import socket
from collections.abc import Awaitable, Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from aiohttp import WSCloseCode, WSMsgType, web

from needlefit.errors import ConfigError, NeedlefitError
from needlefit.viewer.exports.export import KINDS, export
from needlefit.viewer.overlay.band import band
from needlefit.viewer.overlay.slice import slice_of
from needlefit.viewer.serving.door import HEADERS, LARGEST, LOOPBACK, Door, Pace
from needlefit.viewer.serving.messages import Message, read
from needlefit.viewer.serving.picture import band_message
from needlefit.viewer.serving.trial import Trial
from needlefit.viewer.serving.trials import Trials
from needlefit.viewer.serving.window import Reply, Window

PAGE = Path(__file__).parent.parent / "page"

PATIENCE = 10.0
"""Time in which a window must say its token, s."""

BETWEEN_BANDS = 0.15
"""Pause between two bands, s: they are drawn from a hundred needles beside the one that is steered."""

MOST_WINDOWS = 16

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class Server:
    """What all requests share."""

    def __init__(self, door: Door, trials: Trials) -> None:
        self.door, self.trials = door, trials
        self._sockets: dict[str, web.WebSocketResponse] = {}
        self._pool: ProcessPoolExecutor | None = None

    def application(self) -> web.Application:
        """Return the routes."""
        app = web.Application(middlewares=[self._guarded], client_max_size=LARGEST)
        app.router.add_get("/", _index)
        app.router.add_get("/ws", self._attend)
        app.router.add_post("/export/{kind}", self._export)
        app.router.add_post("/slice", self._slice)
        app.router.add_static("/page", PAGE)
        app.on_response_prepare.append(_sealed)
        app.on_shutdown.append(self._leave)
        return app

    @web.middleware
    async def _guarded(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Keep out who calls this server by another name, and who has no token where one is due."""
        if not self.door.at_home(request.headers):
            raise web.HTTPMisdirectedRequest(text="this server answers to 127.0.0.1 and localhost alone")
        if request.method == "POST":
            scheme, _, token = request.headers.get("Authorization", "").partition(" ")
            if scheme != "Bearer" or not self.door.knows(token):
                raise web.HTTPForbidden(text="the token is missing or wrong: open the address as printed")
        if (request.method == "POST" or request.path == "/ws") and not self.door.from_page(request.headers):
            raise web.HTTPForbidden(text="only the page that this server gave out may ask for that")
        return await handler(request)

    async def _attend(self, request: web.Request) -> web.WebSocketResponse:
        """Serve one window for as long as it is there."""
        socket_ = web.WebSocketResponse(timeout=2.0, max_msg_size=LARGEST, heartbeat=20.0, compress=False)
        await socket_.prepare(request)
        hello = await self._hello(socket_)
        if hello is None:
            return socket_
        window = Window(self.trials, self.trials.open(hello.text("needle")))
        await self._take(window.trial, socket_)
        bands = asyncio.create_task(_send_bands(window, socket_))
        try:
            await _send(socket_, list(window.answer(hello)))
            await self._converse(window, socket_)
        finally:
            bands.cancel()
            self._let_go(window.trial, socket_)
        return socket_

    async def _hello(self, socket_: web.WebSocketResponse) -> Message | None:
        """Return a window's first message; None, the socket closed, if it is not the right one."""
        try:
            message = read(await socket_.receive_str(timeout=PATIENCE))
        except (TypeError, TimeoutError):
            message = Message("")
        if message.do != "hello" or not self.door.knows(message.said.get("token")):
            await socket_.close(code=4401, message=b"the token is missing or wrong")
            return None
        if len(self._sockets) >= MOST_WINDOWS and message.text("needle") not in self._sockets:
            await socket_.close(code=WSCloseCode.TRY_AGAIN_LATER, message=b"too many windows are open")
            return None
        return message

    async def _take(self, trial: Trial, socket_: web.WebSocketResponse) -> None:
        """Give a needle to this window; whoever had it is told."""
        before = self._sockets.get(trial.name)
        self._sockets[trial.name] = socket_
        if before is not None:
            await _send(before, [{"kind": "taken"}])
            await before.close(code=4409, message=b"another window has taken the needle")

    async def _converse(self, window: Window, socket_: web.WebSocketResponse) -> None:
        pace = Pace()
        async for frame in socket_:
            if frame.type is not WSMsgType.TEXT or not pace.allows():
                await socket_.close(code=WSCloseCode.POLICY_VIOLATION, message=b"too much, or no text")
                return
            message, trial = read(frame.data), window.trial
            if message.do == "show":  # reads a dataset: other windows go on meanwhile
                with suppress(NeedlefitError):  # the answer says it
                    await asyncio.to_thread(self.trials.prepare, trial, message.text("insertion"))
            if self._sockets.get(trial.name) is not socket_:
                return  # another window has taken the needle
            replies = list(window.answer(message))
            if window.trial is not trial:
                self._let_go(trial, socket_)
                self._sockets[window.trial.name] = socket_
            await _send(socket_, replies)

    def _let_go(self, trial: Trial, socket_: web.WebSocketResponse) -> None:
        """Note that a window steers a needle no more, unless another one has taken it."""
        if self._sockets.get(trial.name) is socket_:
            del self._sockets[trial.name]
            self.trials.close(trial)

    async def _export(self, request: web.Request) -> web.Response:
        """Return a file made from a recording, by a process of its own: frames go on meanwhile."""
        kind = request.match_info["kind"]
        trial = await self._asked(request)
        if kind not in KINDS:
            raise web.HTTPNotFound(text=f"there is no export {kind}; there are {', '.join(KINDS)}")
        self._pool = self._pool or ProcessPoolExecutor(1, mp_context=get_context("spawn"))
        try:
            trial.recorder.begin()
            found = await asyncio.get_running_loop().run_in_executor(
                self._pool, export, trial.recorder.path, kind
            )
        except (NeedlefitError, OSError) as error:
            raise web.HTTPUnprocessableEntity(text=str(error)) from error
        return web.Response(body=found, content_type=KINDS[kind])

    async def _slice(self, request: web.Request) -> web.Response:
        """Return the scan's slice in the bending plane."""
        scanned = (await self._asked(request)).subject.scanned
        if scanned is None:
            raise web.HTTPNotFound(text="there is no scan of this insertion")
        try:
            found = await asyncio.to_thread(slice_of, scanned)
        except (NeedlefitError, OSError) as error:
            raise web.HTTPUnprocessableEntity(text=str(error)) from error
        extent = ",".join(f"{edge:.4f}" for edge in found.extent)
        return web.Response(body=found.png, content_type="image/png", headers={"X-Extent-Mm": extent})

    async def _asked(self, request: web.Request) -> Trial:
        """Return the trial that a request is about."""
        try:
            said = await request.json()
            trial = self.trials.known(said["needle"])
        except (ValueError, LookupError, TypeError):  # no JSON, of no known charset, or about no needle
            trial = None
        if trial is None:
            raise web.HTTPNotFound(text="there is no such needle: reload the page")
        return trial

    async def _leave(self, _: web.Application) -> None:
        """Say goodbye to every window."""
        for socket_ in list(self._sockets.values()):
            await _send(socket_, [{"kind": "bye", "what": "the server was stopped"}])
            await socket_.close(code=WSCloseCode.GOING_AWAY)
        if self._pool:
            self._pool.shutdown(wait=False, cancel_futures=True)


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
    runner = web.AppRunner(Server(door, trials).application(), access_log=None, shutdown_timeout=2.0)
    await runner.setup()
    try:
        await web.SockSite(runner, listening).start()
        ready(door)
        await stop()
    finally:
        await runner.cleanup()


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


async def _send(socket_: web.WebSocketResponse, replies: list[Reply]) -> None:
    for reply in replies:
        if socket_.closed:
            return
        try:
            await socket_.send_str(json.dumps(reply, allow_nan=False, separators=(",", ":")))
        except ConnectionError:
            return  # it has gone; whatever it did is recorded


async def _send_bands(window: Window, socket_: web.WebSocketResponse) -> None:
    """Send the fit's band of the needle as it stands, again and again when it has moved."""
    told: Any = None
    while True:
        trial = window.trial
        spread, number = trial.subject.spread, (trial.name, trial.steering.number)
        if spread is not None and number != told:
            told, steering = number, trial.steering
            found = await asyncio.to_thread(
                band, spread, trial.scene.needle, steering.now.tissue, steering.course(),
                trial.scene.rules, steering.first_cell,
            )  # fmt: skip
            if trial is window.trial:
                await _send(socket_, [band_message(number[1], found)])
        await asyncio.sleep(BETWEEN_BANDS)
