"""The local server of a page: access control, WebSockets, exports, and the pages of needles and scans."""

import asyncio
import json
import secrets
import traceback
from collections.abc import Awaitable, Callable, Coroutine
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing import get_context
from socket import create_server
from time import monotonic, time
from typing import TYPE_CHECKING, Any, Protocol

from aiohttp import WSCloseCode, WSMsgType, web
from aiohttp.typedefs import Handler
from aiohttp.web_protocol import RequestHandler

from needlefit.errors import ConfigError, NeedlefitError
from needlefit.planning.steering import PlanLimits, find_reachable_region, plan_steering
from needlefit.viewer.export import EXPORT_TYPES, PAGE, export
from needlefit.viewer.live_fit import draw_about, find_mode, move_points, select_insertions, show_moved
from needlefit.viewer.messages import (
    Message,
    encode_band,
    encode_fault,
    parse_json,
    read_message,
    round_lengths,
)
from needlefit.viewer.overlays import compute_band, read_slice
from needlefit.viewer.plans import BEYOND_TARGET_MM, draw_challenge, plan_message
from needlefit.viewer.scan_session import ScanSession
from needlefit.viewer.tracking import TrackedTrial
from needlefit.viewer.trials import InteractiveTrial, Reply, TrialRegistry, Window

if TYPE_CHECKING:
    from needlefit.viewer.openigtlink import OpenIGTLinkServer

LOOPBACK = "127.0.0.1"
MAX_MESSAGE_BYTES = 16 * 1024  #: size limit of a message; the largest from the page has a few hundred bytes
#: messages per second that a window may send, and how many may arrive at once after a pause; a page sends up
#: to 250 inputs, and one for each of its frames
MAX_MESSAGES_PER_S, MAX_BURST_MESSAGES = 1000.0, 2000.0
TOKEN_TIMEOUT_S = 10.0  #: time in which a window must send its token, s
#: time in which a request must have come whole, s, and pause between two looks at the connections
REQUEST_TIMEOUT_S, CHECK_INTERVAL_S = 10.0, 1.0
#: pauses between two bands, s (each takes a hundred simulated needles), and before the next look for a goal
#: or a wish for a plan, for a wish for a fit, and for a needle that was moved by a tracker
BAND_INTERVAL_S, PLAN_INTERVAL_S, FIT_INTERVAL_S, TRACKING_INTERVAL_S = 0.15, 0.1, 0.03, 0.03
STATUS_INTERVAL_S = 0.25  #: pause between two reports of a tracked needle, s
MAX_WINDOWS = 16
#: codes for closing a socket: no token, or another window controls the needle
CLOSE_NO_TOKEN, CLOSE_TAKEN = 4401, 4409

#: headers of every answer: the page runs only code of this server, and connects only to it
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}

#: connections that have sent a whole request
_SPOKEN: web.AppKey[set[RequestHandler]] = web.AppKey("spoken", set)


@dataclass(frozen=True)
class AccessControl:
    """The rules by which a request is accepted: host, origin and token."""

    port: int  #: on which the server listens
    #: made anew for every server
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"{host}:{self.port}" for host in (LOOPBACK, "localhost"))

    @property
    def address(self) -> str:
        """The address of the page; the token follows `#`, a part that browsers send to no server."""
        return f"http://{LOOPBACK}:{self.port}/#token={self.token}"

    def is_token(self, token: object) -> bool:
        """Whether a text is the token; the comparison takes the same time for every text."""
        # An ordinary comparison ends at the first difference; its duration would reveal how much of a guess
        # is right. Headers that are no UTF-8 come with surrogates.
        return isinstance(token, str) and secrets.compare_digest(
            token.encode(errors="surrogatepass"), self.token.encode()
        )


class RateLimit:
    """The limit of a window's messages: `MAX_MESSAGES_PER_S`, `MAX_BURST_MESSAGES` after a pause."""

    def __init__(self) -> None:
        self._left, self._at = MAX_BURST_MESSAGES, monotonic()

    def allows(self) -> bool:
        now = monotonic()
        # A token bucket: the allowance grows with time up to the burst, and each message takes one.
        self._left = min(MAX_BURST_MESSAGES, self._left + MAX_MESSAGES_PER_S * (now - self._at))
        self._at = now
        if self._left < 1:
            return False
        self._left -= 1
        return True


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
    """Serve a page on the loopback until `stop` returns; ConfigError if the port is taken.

    `port` 0 is one that is free. `ready` is called once the page can be opened; `stop` is awaited meanwhile.
    """
    # The socket is opened before the address is made: port 0 gets its number only then.
    try:
        listening = create_server((LOOPBACK, port))
    except (OSError, OverflowError) as error:
        raise ConfigError(
            f"port {port} cannot be used: {getattr(error, 'strerror', error)}",
            where="--port",
            expected="a free port from 1024 to 65535",
            fix="leave --port out: a free one is then taken",
        ) from error
    access = AccessControl(listening.getsockname()[1])
    app = _make_application(access, page)
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


def _make_application(access: AccessControl, page: ServedPage) -> web.Application:
    """Return the routes of every page, and those of this one."""

    @web.middleware
    async def guard(request: web.Request, handler: Handler) -> web.StreamResponse:
        """Keep out who calls this server by another name, and who has no token where one is due."""
        request.app[_SPOKEN].add(request.protocol)
        if request.headers.get("Host", "") not in access.names:
            raise web.HTTPMisdirectedRequest(text="this server answers to 127.0.0.1 and localhost alone")
        if request.method == "POST":
            scheme, _, token = request.headers.get("Authorization", "").partition(" ")
            if scheme != "Bearer" or not access.is_token(token):
                raise web.HTTPForbidden(text="the token is missing or wrong: open the address as printed")
        own = [f"http://{name}" for name in access.names]
        if (request.method == "POST" or request.path == "/ws") and request.headers.get("Origin") not in own:
            raise web.HTTPForbidden(text="only the page that this server gave out may ask for that")
        try:
            async with asyncio.timeout(REQUEST_TIMEOUT_S):
                await request.read()  # kept for the handler
        except TimeoutError:
            raise web.HTTPRequestTimeout(text="the request was not sent to its end") from None
        return await handler(request)

    async def send_index(_: web.Request) -> web.FileResponse:
        return web.FileResponse(PAGE / page.index)

    async def add_headers(_: web.Request, response: web.StreamResponse) -> None:
        response.headers.update(HEADERS)

    app = web.Application(middlewares=[guard], client_max_size=MAX_MESSAGE_BYTES)
    app[_SPOKEN] = set()
    app.router.add_get("/", send_index)
    app.router.add_static("/page", PAGE)
    app.on_response_prepare.append(add_headers)
    page.add_routes(app, access)
    return app


class ScanPage:
    """The page of one scan; what takes long runs in a thread, one examination at a time."""

    index = "scan.html"

    def __init__(self, session: ScanSession) -> None:
        self.session = session
        self._examining = asyncio.Lock()

    def add_routes(self, app: web.Application, _: AccessControl) -> None:
        for name in ("describe", "cut", "again", "save"):
            app.router.add_post(f"/scan/{name}", getattr(self, name))

    async def describe(self, _: web.Request) -> web.Response:
        async with self._examining:
            return web.json_response(await asyncio.to_thread(self.session.describe))

    async def cut(self, request: web.Request) -> web.Response:
        return web.Response(body=await self._run(self.session.cut, request), content_type="image/png")

    async def again(self, request: web.Request) -> web.Response:
        """Examine the scan again with corrections; return what was found then."""
        async with self._examining:
            await self._run(self.session.again, request)
            return web.json_response(await asyncio.to_thread(self.session.describe))

    async def save(self, request: web.Request) -> web.Response:
        async with self._examining:
            path = await self._run(self.session.save_shown, request)
        return web.json_response({"table": str(path), "command": self.session.command(path)})

    async def _run(self, work: Callable[[Any], Any], request: web.Request) -> Any:  # noqa: ANN401 - as of `work`
        try:
            content = await request.json(loads=parse_json)
        except ValueError:  # no JSON, or of no known charset
            raise web.HTTPBadRequest(text="the request is no JSON") from None
        try:
            return await asyncio.to_thread(work, content)
        except (NeedlefitError, OSError) as error:
            fault = error if isinstance(error, NeedlefitError) else NeedlefitError(str(error))
            text = json.dumps(encode_fault(fault, "what", "where", "expected", "fix"))
            raise web.HTTPUnprocessableEntity(text=text, content_type="application/json") from error


class SteeringPage:
    """The page of the interactive simulation, and the OpenIGTLink server beside it, if there is one.

    Each window has a WebSocket, and each needle one window, the newest.
    """

    index = "index.html"

    def __init__(self, trials: TrialRegistry, openigtlink: "OpenIGTLinkServer | None" = None) -> None:
        self.trials, self.openigtlink = trials, openigtlink
        self._tracked = openigtlink.tracked if openigtlink else None
        self._pool: ProcessPoolExecutor | None = None
        self._sockets: dict[str, web.WebSocketResponse] = {}

    def add_routes(self, app: web.Application, access: AccessControl) -> None:
        if self.openigtlink is not None:
            app.cleanup_ctx.append(self.openigtlink.run)
        app.router.add_get("/ws", partial(self.attend, access))
        app.router.add_post("/export/{kind}", self.export)
        app.router.add_post("/slice", self.cut)
        app.on_shutdown.append(self.leave)

    async def export(self, request: web.Request) -> web.Response:
        """Return a file made from a recording, by a process of its own: frames go on meanwhile."""
        kind = request.match_info["kind"]
        trial = await self._find_trial(request)
        if kind not in EXPORT_TYPES:
            raise web.HTTPNotFound(text=f"there is no export {kind}; there are {', '.join(EXPORT_TYPES)}")
        # spawn: a forked child would share the server's sockets and its threads' locks. The pool starts with
        # the first export, so that a server without exports pays nothing.
        self._pool = self._pool or ProcessPoolExecutor(1, mp_context=get_context("spawn"))
        try:
            trial.recorder.begin()
            loop = asyncio.get_running_loop()
            found = await loop.run_in_executor(self._pool, export, trial.recorder.path, kind)
        except (NeedlefitError, OSError) as error:
            raise web.HTTPUnprocessableEntity(text=str(error)) from error
        except BrokenExecutor as error:
            self._pool = None  # it was killed, perhaps for want of memory; the next one begins anew
            raise web.HTTPInternalServerError(text="the program that made it was ended; try again") from error
        return web.Response(body=found, content_type=EXPORT_TYPES[kind])

    async def cut(self, request: web.Request) -> web.Response:
        """Return the scan's slice in the bending plane."""
        scanned = (await self._find_trial(request)).viewed_scene.scanned
        if scanned is None:
            raise web.HTTPNotFound(text="there is no scan of this insertion")
        try:
            png, edges = await asyncio.to_thread(read_slice, scanned)
        except (NeedlefitError, OSError) as error:
            raise web.HTTPUnprocessableEntity(text=str(error)) from error
        extent = ",".join(f"{edge:.4f}" for edge in edges)
        return web.Response(body=png, content_type="image/png", headers={"X-Extent-Mm": extent})

    async def _find_trial(self, request: web.Request) -> InteractiveTrial:
        try:
            content = await request.json(loads=parse_json)
            trial = self.trials.known(content["needle"])
        except (ValueError, LookupError, TypeError):  # no JSON, of no known charset, or about no needle
            trial = None
        if trial is None:
            raise web.HTTPNotFound(text="there is no such needle: reload the page")
        return trial

    async def attend(self, access: AccessControl, request: web.Request) -> web.WebSocketResponse:
        """Serve one window for as long as it is there."""
        socket = web.WebSocketResponse(
            timeout=2.0, max_msg_size=MAX_MESSAGE_BYTES, heartbeat=20.0, compress=False
        )
        await socket.prepare(request)
        hello = await self._hello(access, socket)
        if hello is None:
            return socket
        window = Window(self.trials, self.trials.open(hello.text("needle")))
        before, self._sockets[window.trial.name] = self._sockets.get(window.trial.name), socket
        if before is not None:
            await _send(before, {"kind": "taken"})
            await before.close(code=CLOSE_TAKEN, message=b"another window has taken the needle")
        work = [_send_bands(window, socket), _send_plans(window, socket), _send_fits(window, socket)]
        if self._tracked is not None:
            work.append(_send_tracking(window, socket, self._tracked))
        sending = [asyncio.create_task(_close_if_failed(one, socket)) for one in work]
        try:
            async with window.trial.lock:
                replies = list(window.answer(hello))
            await _send(socket, *replies)
            await self._converse(window, socket)
        finally:
            for task in sending:
                task.cancel()
            self._let_go(window.trial, socket)
        return socket

    async def leave(self, _: web.Application) -> None:
        """Say goodbye to every window; wait for nothing that is still being made."""
        if self._pool:
            self._pool.shutdown(wait=False, cancel_futures=True)
        for socket in list(self._sockets.values()):
            await _send(socket, {"kind": "bye", "what": "the server was stopped"})
            await socket.close(code=WSCloseCode.GOING_AWAY)

    async def _hello(self, access: AccessControl, socket: web.WebSocketResponse) -> Message | None:
        """Return a window's first message; None, the socket closed, if it is not the right one."""
        try:
            message = read_message(await socket.receive_str(timeout=TOKEN_TIMEOUT_S))
        except (TypeError, TimeoutError):
            message = Message("")
        if message.do != "hello" or not access.is_token(message.content.get("token")):
            await socket.close(code=CLOSE_NO_TOKEN, message=b"the token is missing or wrong")
            return None
        if len(self._sockets) >= MAX_WINDOWS and message.text("needle") not in self._sockets:
            await socket.close(code=WSCloseCode.TRY_AGAIN_LATER, message=b"too many windows are open")
            return None
        return message

    async def _converse(self, window: Window, socket: web.WebSocketResponse) -> None:
        pace = RateLimit()
        async for frame in socket:
            if frame.type is not WSMsgType.TEXT or not pace.allows():
                await socket.close(code=WSCloseCode.POLICY_VIOLATION, message=b"too much, or no text")
                return
            message, trial = read_message(frame.data), window.trial
            if self._tracked is not None and message.do == "release_tracker":
                self._tracked.release()
            elif self._tracked is not None and message.do == "forget_estimate":
                self._tracked.forget()
            if message.do == "show":  # reads a dataset: other windows go on meanwhile
                with suppress(NeedlefitError):  # the reply reports the error
                    await asyncio.to_thread(self.trials.prepare, trial, message.text("insertion"))
            async with trial.lock:
                if self._sockets.get(trial.name) is not socket:
                    return  # another window has taken the needle
                if self._tracked is None and any(change.is_parameter for change in message.changes):
                    # simulates the whole insertion again: other windows go on meanwhile
                    replies = await asyncio.to_thread(list, window.answer(message))
                else:
                    replies = list(window.answer(message))
            if window.trial is not trial:
                self._let_go(trial, socket)
                self._sockets[window.trial.name] = socket
            await _send(socket, *replies)

    def _let_go(self, trial: InteractiveTrial, socket: web.WebSocketResponse) -> None:
        """Note that a window steers a needle no more, unless another one has taken it."""
        if self._sockets.get(trial.name) is socket:
            del self._sockets[trial.name]
            self.trials.close(trial)


async def _send(socket: web.WebSocketResponse, *replies: Reply) -> None:
    for reply in replies:
        if socket.closed:
            return
        try:
            await socket.send_str(json.dumps(reply, allow_nan=False, separators=(",", ":")))
        except ConnectionError:
            return  # it has gone; whatever it did is recorded


async def _close_if_failed(work: Coroutine[Any, Any, None], socket: web.WebSocketResponse) -> None:
    """Do what goes on beside a conversation; if it fails, close the window's socket: the page begins anew."""
    try:
        await work
    except Exception:
        traceback.print_exc()
        await socket.close(code=WSCloseCode.INTERNAL_ERROR, message=b"the program failed; see its terminal")


async def _send_bands(window: Window, socket: web.WebSocketResponse) -> None:
    """Send the fit's band of the needle as it stands, again and again when it has moved."""
    sent: Any = None
    while True:
        trial = window.trial
        spread, step = trial.viewed_scene.spread, trial.steering.number
        if spread is not None and (trial.name, step, id(spread)) != sent:
            sent = (trial.name, step, id(spread))
            found = await asyncio.to_thread(compute_band, trial.insertion)
            # The window may have changed its trial while the band was computed.
            if trial is window.trial:
                await _send(socket, encode_band(step, found))
        await asyncio.sleep(BAND_INTERVAL_S)


async def _send_plans(window: Window, socket: web.WebSocketResponse) -> None:
    """Send goals when they change, the region that the tip can reach, and plans that were asked for."""
    aimed: Any = None
    reached: Any = None
    while True:
        trial, aim = window.trial, window.trial.aim
        if aimed != (trial.name, aim.version):
            if aimed is not None or aim.version:
                await _send(socket, aim.to_message())
            if aim.plan is not None:  # of a page that was reloaded, or of a needle at the entry of its plan
                await _send(socket, plan_message(aim.plan, aim))
            aimed, reached = (trial.name, aim.version), None
        step, version, depth = trial.steering.number, aim.version, trial.scene.depth
        if aim.challenged:
            aim.challenged, aim.entry_mm = False, 0.0
            goal_parts = await asyncio.to_thread(draw_challenge, trial.insertion, depth, aim.radius)
            if version == aim.version:
                aim.set(*goal_parts)
                aim.wanted = aim.goal is not None
        elif aim.goal is not None and aim.wanted:
            aim.wanted = False
            limits, plan, fault = PlanLimits(aim.entry_mm), None, Reply()
            try:
                plan = await asyncio.to_thread(
                    plan_steering, trial.planned_insertion, aim.goal, limits, threads=1
                )
            except NeedlefitError as error:
                fault = {"kind": "plan", "fault": encode_fault(error)}
            if version == aim.version and trial is window.trial:
                aim.plan, aim.plan_step = plan, step
                await _send(socket, plan_message(plan, aim) if plan else fault)
        # not while it moves: the region takes a third of a second
        elif aim.goal is not None and not window.moves and reached != step:
            reached, depth = step, max(aim.goal.target[0] + BEYOND_TARGET_MM, depth)
            region = await asyncio.to_thread(find_reachable_region, trial.insertion, depth, threads=1)
            if trial is window.trial:
                edges = {
                    "low": region.low,
                    "high": region.high,
                }  # from the least share of draws to the greatest
                rows = {name: [round_lengths(one) for one in edge] for name, edge in edges.items()}
                await _send(socket, {"kind": "reach", "step": step, "x": round_lengths(region.x), **rows})
        await asyncio.sleep(PLAN_INTERVAL_S)


async def _send_fits(window: Window, socket: web.WebSocketResponse) -> None:
    """Move measured points, fit and draw as the page asks; the page takes the fitted values as its input."""
    while True:
        trial = window.trial
        if trial.measured is not None and trial.wanted_offsets:
            offsets, trial.wanted_offsets = trial.wanted_offsets, []
            trial.viewed_scene = show_moved(trial.viewed_scene, move_points(trial.measured, offsets))
            assert trial.viewed_scene.measured is not None
            x, y = map(round_lengths, trial.viewed_scene.measured.points.T)
            await _send(socket, {"kind": "measured", "x": x, "y": y, "offsets": offsets})
        shown, scope = trial.viewed_scene.shown, trial.wanted_fit
        if shown is not None and scope is not None:
            trial.wanted_fit = None
            try:
                mode = await asyncio.to_thread(find_mode, shown, select_insertions(shown, scope))
                await _send(socket, mode.to_message(shown.insertion))
                if trial.wanted_fit is None:  # else its draws would be of no use
                    draws = await asyncio.to_thread(draw_about, mode, shown.insertion, shown.seed)
                    trial.viewed_scene = replace(trial.viewed_scene, spread=draws.spread)
                    await _send(socket, draws.to_message())
            except NeedlefitError as error:
                await _send(socket, {"kind": "fit", "fault": encode_fault(error, "what", "fix")})
        await asyncio.sleep(FIT_INTERVAL_S)


async def _send_tracking(window: Window, socket: web.WebSocketResponse, tracked: TrackedTrial) -> None:
    """Send the needle when a tracker has moved it, and what is known of tracker and estimate."""
    step: Any = None
    number, reported = -1, 0.0
    while True:
        if (now := (window.trial.name, window.trial.steering.number)) != step:
            step = now
            await _send(socket, window.state())
        if tracked.number != number or monotonic() - reported > STATUS_INTERVAL_S:
            number, reported = tracked.number, monotonic()
            await _send(socket, tracked.status(time()))
        await asyncio.sleep(TRACKING_INTERVAL_S)
