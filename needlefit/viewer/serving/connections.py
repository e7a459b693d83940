"""The WebSocket connections of all windows; each has its own needle."""

import asyncio
import json
import secrets
import traceback
from collections.abc import Coroutine, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from time import monotonic, time
from typing import Any

from aiohttp import WSCloseCode, WSMsgType, web

from needlefit.errors import NeedlefitError
from needlefit.viewer.encoding import encode_band
from needlefit.viewer.interaction.inputs import is_parameter
from needlefit.viewer.opening.live_fit import (
    draw_about,
    find_mode,
    move_points,
    select_insertions,
    show_moved,
)
from needlefit.viewer.opening.plan import continue_insertion
from needlefit.viewer.overlay.band import compute_band
from needlefit.viewer.serving.fits import draws_message, measured_message, mode_message
from needlefit.viewer.serving.messages import Message, read_message
from needlefit.viewer.serving.plans import (
    aim_message,
    begin_plan,
    draw_challenge,
    find_region,
    make_plan,
    plan_message,
    region_message,
)
from needlefit.viewer.serving.tracking import TrackedTrial
from needlefit.viewer.serving.trials import InteractiveTrial, TrialRegistry
from needlefit.viewer.serving.window import Reply, Window

LOOPBACK = "127.0.0.1"

MAX_MESSAGE_BYTES = 16 * 1024
"""Size limit of a message; the largest from the page has a few hundred bytes."""

MAX_MESSAGES_PER_S = 1000.0
"""Messages per second that a window may send; a page sends up to 250 inputs, and one for each of its
frames."""

MAX_BURST_MESSAGES = 2000.0
"""Number of messages that may arrive at once after a pause."""

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
"""Headers of every answer: the page runs only code of this server, and connects only to it."""


@dataclass(frozen=True)
class AccessControl:
    """The rules by which a request is accepted: host, origin and token.

    Attributes
    ----------
    port : int
        On which the server listens.
    token : str
        Made anew for every server.
    """

    port: int
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """The host names of this server."""
        return tuple(f"{host}:{self.port}" for host in (LOOPBACK, "localhost"))

    @property
    def address(self) -> str:
        """The address of the page; the token follows `#`, a part that browsers send to no server."""
        return f"http://{LOOPBACK}:{self.port}/#token={self.token}"

    def has_own_host(self, headers: Mapping[str, str]) -> bool:
        """Whether a request names this server as its host."""
        return headers.get("Host", "") in self.names

    def from_page(self, headers: Mapping[str, str]) -> bool:
        """Whether a request comes from this server's own page."""
        return headers.get("Origin", "") in tuple(f"http://{name}" for name in self.names)

    def is_token(self, token: object) -> bool:
        """Whether a text is the token; the comparison takes the same time for every text."""
        # An ordinary comparison ends at the first difference; its duration would reveal how much of a guess
        # is right.
        # Headers that are no UTF-8 come with surrogates.
        return isinstance(token, str) and secrets.compare_digest(
            token.encode(errors="surrogatepass"), self.token.encode()
        )


class RateLimit:
    """The limit of a window's messages: `MAX_MESSAGES_PER_S`, `MAX_BURST_MESSAGES` after a pause."""

    def __init__(self) -> None:
        self._left, self._at = MAX_BURST_MESSAGES, monotonic()

    def allows(self) -> bool:
        """Whether one more message is within the limit now."""
        now = monotonic()
        # A token bucket: the allowance grows with time up to the burst, and each message takes one.
        self._left = min(MAX_BURST_MESSAGES, self._left + MAX_MESSAGES_PER_S * (now - self._at))
        self._at = now
        if self._left < 1:
            return False
        self._left -= 1
        return True


TOKEN_TIMEOUT_S = 10.0
"""Time in which a window must send its token, s."""

BAND_INTERVAL_S = 0.15
"""Pause between two bands, s: each takes a hundred simulated needles."""

PLAN_INTERVAL_S = 0.1
"""Pause before the next look for a goal or a wish for a plan, s."""

FIT_INTERVAL_S = 0.03
"""Pause before the next look for a wish for a fit, s."""

TRACKING_INTERVAL_S, STATUS_INTERVAL_S = 0.03, 0.25
"""Pause before the next look for a needle that was moved by a tracker, and between two reports of it, s."""

MAX_WINDOWS = 16

CLOSE_NO_TOKEN, CLOSE_TAKEN = 4401, 4409
"""Codes for closing a socket: no token, or another window controls the needle."""


class Connections:
    """All connections: one for each window, and one window for each needle, the newest."""

    def __init__(
        self, access: AccessControl, trials: TrialRegistry, tracked: TrackedTrial | None = None
    ) -> None:
        self.access, self.trials, self.tracked = access, trials, tracked
        self._sockets: dict[str, web.WebSocketResponse] = {}

    async def attend(self, request: web.Request) -> web.WebSocketResponse:
        """Serve one window for as long as it is there."""
        socket = web.WebSocketResponse(
            timeout=2.0, max_msg_size=MAX_MESSAGE_BYTES, heartbeat=20.0, compress=False
        )
        await socket.prepare(request)
        hello = await self._hello(socket)
        if hello is None:
            return socket
        window = Window(self.trials, self.trials.open(hello.text("needle")))
        await self._take(window.trial, socket)
        work = [_send_bands(window, socket), _send_plans(window, socket), _send_fits(window, socket)]
        if self.tracked is not None:
            work.append(_send_tracking(window, socket, self.tracked))
        sending = [asyncio.create_task(_close_if_failed(one, socket)) for one in work]
        try:
            async with window.trial.lock:
                replies = list(window.answer(hello))
            await _send(socket, replies)
            await self._converse(window, socket)
        finally:
            for task in sending:
                task.cancel()
            self._let_go(window.trial, socket)
        return socket

    async def leave(self, _: web.Application) -> None:
        """Say goodbye to every window."""
        for socket in list(self._sockets.values()):
            await _send(socket, [{"kind": "bye", "what": "the server was stopped"}])
            await socket.close(code=WSCloseCode.GOING_AWAY)

    async def _hello(self, socket: web.WebSocketResponse) -> Message | None:
        """Return a window's first message; None, the socket closed, if it is not the right one."""
        try:
            message = read_message(await socket.receive_str(timeout=TOKEN_TIMEOUT_S))
        except (TypeError, TimeoutError):
            message = Message("")
        if message.do != "hello" or not self.access.is_token(message.content.get("token")):
            await socket.close(code=CLOSE_NO_TOKEN, message=b"the token is missing or wrong")
            return None
        if len(self._sockets) >= MAX_WINDOWS and message.text("needle") not in self._sockets:
            await socket.close(code=WSCloseCode.TRY_AGAIN_LATER, message=b"too many windows are open")
            return None
        return message

    async def _take(self, trial: InteractiveTrial, socket: web.WebSocketResponse) -> None:
        """Give a needle to this window; the window that had it is notified."""
        before = self._sockets.get(trial.name)
        self._sockets[trial.name] = socket
        if before is not None:
            await _send(before, [{"kind": "taken"}])
            await before.close(code=CLOSE_TAKEN, message=b"another window has taken the needle")

    async def _converse(self, window: Window, socket: web.WebSocketResponse) -> None:
        pace = RateLimit()
        async for frame in socket:
            if frame.type is not WSMsgType.TEXT or not pace.allows():
                await socket.close(code=WSCloseCode.POLICY_VIOLATION, message=b"too much, or no text")
                return
            message, trial = read_message(frame.data), window.trial
            if self.tracked is not None and message.do == "release_tracker":
                self.tracked.release()
            elif self.tracked is not None and message.do == "forget_estimate":
                self.tracked.forget()
            if message.do == "show":  # reads a dataset: other windows go on meanwhile
                with suppress(NeedlefitError):  # the reply reports the error
                    await asyncio.to_thread(self.trials.prepare, trial, message.text("insertion"))
            async with trial.lock:
                if self._sockets.get(trial.name) is not socket:
                    return  # another window has taken the needle
                if self.tracked is None and any(is_parameter(change.name) for change in message.changes):
                    # simulates the whole insertion again: other windows go on meanwhile
                    replies = await asyncio.to_thread(list, window.answer(message))
                else:
                    replies = list(window.answer(message))
            if window.trial is not trial:
                self._let_go(trial, socket)
                self._sockets[window.trial.name] = socket
            await _send(socket, replies)

    def _let_go(self, trial: InteractiveTrial, socket: web.WebSocketResponse) -> None:
        """Note that a window steers a needle no more, unless another one has taken it."""
        if self._sockets.get(trial.name) is socket:
            del self._sockets[trial.name]
            self.trials.close(trial)


async def _send(socket: web.WebSocketResponse, replies: list[Reply]) -> None:
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
        spread = trial.viewed_scene.spread
        number = (trial.name, trial.steering.number, id(spread))
        if spread is not None and number != sent:
            sent, steering = number, trial.steering
            found = await asyncio.to_thread(
                compute_band, spread, trial.scene.needle, steering.now.tissue, steering.input_path(),
                trial.scene.rules, steering.first_cell,
            )  # fmt: skip
            # The window may have changed its trial while the band was computed.
            if trial is window.trial:
                await _send(socket, [encode_band(number[1], found)])
        await asyncio.sleep(BAND_INTERVAL_S)


async def _send_plans(window: Window, socket: web.WebSocketResponse) -> None:
    """Send goals when they change, the region that the tip can reach, and plans that were asked for."""
    aimed: Any = None
    reached: Any = None
    while True:
        trial, aim = window.trial, window.trial.aim
        if aimed != (trial.name, aim.version):
            if aimed is not None or aim.version:
                await _send(socket, [aim_message(aim)])
            if aim.plan is not None:  # of a page that was reloaded, or of a needle at the entry of its plan
                await _send(socket, [plan_message(aim.plan, aim)])
            aimed, reached = (trial.name, aim.version), None
        if aim.challenged:
            insertion = continue_insertion(trial.steering, trial.viewed_scene)
            aim.challenged, aim.entry_mm, version = False, 0.0, aim.version
            goal_parts = await asyncio.to_thread(draw_challenge, insertion, trial.scene.depth, aim.radius)
            if version == aim.version:
                aim.set(*goal_parts)
                aim.wanted = aim.goal is not None
        elif aim.goal is not None and aim.wanted:
            aim.wanted, version, step = False, aim.version, trial.steering.number
            found = await asyncio.to_thread(make_plan, begin_plan(trial), aim.goal, aim.entry_mm)
            if version == aim.version and trial is window.trial:
                aim.plan, aim.plan_step = None if isinstance(found, NeedlefitError) else found, step
                await _send(socket, [plan_message(found, aim)])
        # not while it moves: the region takes a third of a second
        elif aim.goal is not None and not window.moves and reached != trial.steering.number:
            reached = trial.steering.number
            insertion, goal = continue_insertion(trial.steering, trial.viewed_scene), aim.goal
            region = await asyncio.to_thread(find_region, insertion, goal, trial.scene.depth)
            if trial is window.trial:
                await _send(socket, [region_message(region, reached)])
        await asyncio.sleep(PLAN_INTERVAL_S)


async def _send_fits(window: Window, socket: web.WebSocketResponse) -> None:
    """Move measured points, fit and draw as the page asks; the page takes the fitted values as its input."""
    while True:
        trial, fit = window.trial, window.trial.fit
        if fit.original is not None and fit.offsets is not None:
            offsets, fit.offsets = fit.offsets, None
            trial.viewed_scene = show_moved(trial.viewed_scene, move_points(fit.original, offsets))
            await _send(socket, [measured_message(trial.viewed_scene, offsets)])
        shown, scope = trial.viewed_scene.shown, fit.wanted
        if shown is not None and scope is not None:
            fit.wanted = None
            insertions = select_insertions(shown, scope)
            try:
                mode = await asyncio.to_thread(find_mode, shown, insertions)
                await _send(socket, [mode_message(mode, shown)])
                if fit.wanted is None:  # else its draws would be of no use
                    draws = await asyncio.to_thread(draw_about, mode, shown.insertion, shown.seed)
                    trial.viewed_scene = replace(trial.viewed_scene, spread=draws.spread)
                    await _send(socket, [draws_message(draws)])
            except NeedlefitError as error:
                await _send(socket, [{"kind": "fit", "fault": {"what": error.what, "fix": error.fix}}])
        await asyncio.sleep(FIT_INTERVAL_S)


async def _send_tracking(window: Window, socket: web.WebSocketResponse, tracked: TrackedTrial) -> None:
    """Send the needle when a tracker has moved it, and what is known of tracker and estimate."""
    step: Any = None
    number, reported = -1, 0.0
    while True:
        if (now := (window.trial.name, window.trial.steering.number)) != step:
            step = now
            await _send(socket, [window.state()])
        if tracked.number != number or monotonic() - reported > STATUS_INTERVAL_S:
            number, reported = tracked.number, monotonic()
            await _send(socket, [tracked.status(time())])
        await asyncio.sleep(TRACKING_INTERVAL_S)
