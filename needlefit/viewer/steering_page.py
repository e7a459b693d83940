"""The page of the interactive simulation: its windows, exports, plans, fits and tracked needles."""

import asyncio
import json
import traceback
from collections.abc import Coroutine
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from time import monotonic, time
from typing import TYPE_CHECKING, Any

import numpy as np
from aiohttp import WSCloseCode, WSMsgType, web

from needlefit.arrays import are_bounded
from needlefit.errors import ModelError, NeedlefitError
from needlefit.planning.steering import (
    PlanLimits,
    StartedInsertion,
    find_reachable_region,
    plan_steering,
)
from needlefit.project.json_values import parse_json
from needlefit.schemas.limits import MAX_NUMBER
from needlefit.viewer.export import EXPORT_TYPES, export
from needlefit.viewer.live_fit import draw_about, find_mode, move_points, select_insertions, show_moved
from needlefit.viewer.messages import (
    encode_draws,
    encode_fault,
    encode_law,
    encode_measured,
    read_message,
    round_lengths,
)
from needlefit.viewer.overlays import read_slice
from needlefit.viewer.plans import BEYOND_TARGET_MM, draw_challenge, plan_message
from needlefit.viewer.server import (
    AccessControl,
    RateLimit,
    add_needle_routes,
    open_socket,
    receive_hello,
)
from needlefit.viewer.tracking import TrackedTrial
from needlefit.viewer.trials import InteractiveTrial, Reply, StepOrderError, TrialRegistry, Window

if TYPE_CHECKING:
    from needlefit.viewer.openigtlink import OpenIGTLinkServer

#: pauses before the next look for a goal or a wish for a plan, for a wish for a fit, and for steps of a
#: tracked needle, s
PLAN_INTERVAL_S, FIT_INTERVAL_S, TRACKING_INTERVAL_S = 0.1, 0.03, 0.03
STATUS_INTERVAL_S = 0.25  #: pause between two reports of a tracked needle, s
MAX_WINDOWS = 16
#: code for closing a socket whose needle another window controls
CLOSE_TAKEN = 4409


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
        add_needle_routes(app, self)

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

    async def compile_law(self, request: web.Request) -> web.Response:
        """Return the law of all layers at shape parameters, where the page cannot compute it."""
        tissue = (await self._find_trial(request)).scene.tissue
        rows = (await request.json(loads=parse_json)).get("shape")
        try:
            shape = np.array(rows, dtype=np.float64)
            if shape.shape != tissue.shape.shape or not are_bounded(shape, MAX_NUMBER):
                raise ModelError("these are no shape parameters", expected="a number for each layer")
            law = await asyncio.to_thread(encode_law, tissue.law, shape)
        except (ValueError, TypeError, NeedlefitError) as error:
            fault = error if isinstance(error, NeedlefitError) else ModelError("these are no numbers")
            text = json.dumps(encode_fault(fault))
            raise web.HTTPUnprocessableEntity(text=text, content_type="application/json") from error
        return web.json_response(law)

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
        socket = await open_socket(request)
        hello = await receive_hello(access, socket)
        return socket if hello is None else await self.converse(socket, hello)

    async def converse(self, socket: web.WebSocketResponse, hello: str) -> web.WebSocketResponse:
        """Serve a window that has the token, for as long as it is there; `hello` is its first message."""
        first = read_message(hello)
        if len(self._sockets) >= MAX_WINDOWS and first.text("needle") not in self._sockets:
            await socket.close(code=WSCloseCode.TRY_AGAIN_LATER, message=b"too many windows are open")
            return socket
        window = Window(self.trials, self.trials.open(first.text("needle")))
        before, self._sockets[window.trial.name] = self._sockets.get(window.trial.name), socket
        if before is not None:
            await _send(before, {"kind": "taken"})
            await before.close(code=CLOSE_TAKEN, message=b"another window has taken the needle")
        work = [_send_plans(window, socket), _send_fits(window, socket)]
        if self._tracked is not None:
            work.append(_send_tracking(window, socket, self._tracked))
        sending = [asyncio.create_task(_close_if_failed(one, socket)) for one in work]
        try:
            async with window.trial.lock:
                replies = list(window.answer(first))
            await _send(socket, *replies)
            await self._answer(window, socket)
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

    async def _answer(self, window: Window, socket: web.WebSocketResponse) -> None:
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
                try:
                    if message.do == "align":  # simulates all steps: other windows go on meanwhile
                        replies = await asyncio.to_thread(list, window.answer(message))
                    else:
                        replies = list(window.answer(message))
                except StepOrderError as error:  # the page begins anew with what is recorded
                    await socket.close(code=WSCloseCode.TRY_AGAIN_LATER, message=str(error).encode())
                    return
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


async def _follow(trial: InteractiveTrial) -> StartedInsertion:
    """Carry out the steps of a page; return the insertion so far."""
    async with trial.lock:
        return await asyncio.to_thread(lambda: trial.insertion)


async def _send_plans(window: Window, socket: web.WebSocketResponse) -> None:
    """Send goals when they change, the region that the tip can reach, and plans that were asked for."""
    aimed: Any = None
    reached: Any = None
    before: Any = None
    while True:
        trial, aim = window.trial, window.trial.aim
        if aimed != (trial.name, aim.version):
            if aimed is not None or aim.version:
                await _send(socket, aim.to_message())
            if aim.plan is not None:  # of a page that was reloaded, or of a needle at the entry of its plan
                await _send(socket, plan_message(aim.plan, aim))
            aimed, reached = (trial.name, aim.version), None
        step, version, depth = len(trial.steps), aim.version, trial.scene.depth
        rests, before = (trial.name, step) == before, (trial.name, step)
        if aim.challenged:
            aim.challenged, aim.entry_mm = False, 0.0
            goal_parts = await asyncio.to_thread(draw_challenge, await _follow(trial), depth, aim.radius)
            if version == aim.version:
                aim.set(*goal_parts)
                aim.wanted = aim.goal is not None
        elif aim.goal is not None and aim.wanted:
            aim.wanted = False
            limits, plan, fault = PlanLimits(aim.entry_mm), None, Reply()
            try:
                await _follow(trial)
                plan = await asyncio.to_thread(
                    plan_steering, trial.planned_insertion, aim.goal, limits, threads=1
                )
            except NeedlefitError as error:
                fault = {"kind": "plan", "fault": encode_fault(error)}
            if version == aim.version and trial is window.trial:
                aim.plan, aim.plan_step = plan, step
                await _send(socket, plan_message(plan, aim) if plan else fault)
        # not while it moves: the region takes a third of a second
        elif aim.goal is not None and rests and reached != step:
            reached, depth = step, max(aim.goal.target[0] + BEYOND_TARGET_MM, depth)
            insertion = await _follow(trial)
            region = await asyncio.to_thread(find_reachable_region, insertion, depth, threads=1)
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
            measured = encode_measured(trial.viewed_scene.measured)
            await _send(socket, {"kind": "measured", "offsets": offsets, **measured})
        shown, scope = trial.viewed_scene.shown, trial.wanted_fit
        if shown is not None and scope is not None:
            trial.wanted_fit = None
            try:
                mode = await asyncio.to_thread(find_mode, shown, select_insertions(shown, scope))
                await _send(socket, mode.to_message(shown.insertion))
                if trial.wanted_fit is None:  # else its draws would be of no use
                    draws = await asyncio.to_thread(draw_about, mode, shown.insertion, shown.seed)
                    trial.viewed_scene = replace(trial.viewed_scene, spread=draws.spread)
                    await _send(socket, _describe_draws(trial), draws.to_message())
            except NeedlefitError as error:
                await _send(socket, {"kind": "fit", "fault": encode_fault(error, "what", "fix")})
        await asyncio.sleep(FIT_INTERVAL_S)


def _describe_draws(trial: InteractiveTrial) -> Reply:
    """Return the message of the draws of a band."""
    assert trial.viewed_scene.spread is not None
    return {"kind": "draws", "draws": encode_draws(trial.viewed_scene.spread, trial.scene.tissue.law)}


async def _send_tracking(window: Window, socket: web.WebSocketResponse, tracked: TrackedTrial) -> None:
    """Send the steps of a needle that a tracker moves, and what is known of tracker and estimate."""
    spread = window.trial.viewed_scene.spread
    number, reported = -1, 0.0
    while True:
        await _send(socket, *window.new_steps())
        if (now := window.trial.viewed_scene.spread) is not spread:
            spread = now
            await _send(socket, *([] if spread is None else [_describe_draws(window.trial)]))
        if tracked.number != number or monotonic() - reported > STATUS_INTERVAL_S:
            number, reported = tracked.number, monotonic()
            await _send(socket, tracked.status(time()))
        await asyncio.sleep(TRACKING_INTERVAL_S)
