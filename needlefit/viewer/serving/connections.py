"""The WebSocket connections of all windows, one needle each."""

import asyncio
import json
from contextlib import suppress
from typing import Any

from aiohttp import WSCloseCode, WSMsgType, web

from needlefit.errors import NeedlefitError
from needlefit.viewer.overlay.band import compute_band
from needlefit.viewer.serving.access_control import MAX_MESSAGE_BYTES, AccessControl, RateLimit
from needlefit.viewer.serving.message_encoding import band_message
from needlefit.viewer.serving.messages import Message, read_message
from needlefit.viewer.serving.trials import InteractiveTrial, TrialRegistry
from needlefit.viewer.serving.window import Reply, Window

TOKEN_TIMEOUT_S = 10.0
"""Time in which a window must say its token, s."""

BAND_INTERVAL_S = 0.15
"""Pause between two bands, s: they are drawn from a hundred needles beside the one that is steered."""

MAX_WINDOWS = 16

CLOSE_NO_TOKEN, CLOSE_TAKEN = 4401, 4409
"""Why a socket is closed, as the page is told: no token, or another window has the needle."""


class Connections:
    """One socket for each window, one window for each needle: the newest."""

    def __init__(self, access: AccessControl, trials: TrialRegistry) -> None:
        self.access, self.trials = access, trials
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
        bands = asyncio.create_task(_send_bands(window, socket))
        try:
            await _send(socket, list(window.answer(hello)))
            await self._converse(window, socket)
        finally:
            bands.cancel()
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
        """Give a needle to this window; whoever had it is told."""
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
            if message.do == "show":  # reads a dataset: other windows go on meanwhile
                with suppress(NeedlefitError):  # the answer says it
                    await asyncio.to_thread(self.trials.prepare, trial, message.text("insertion"))
            if self._sockets.get(trial.name) is not socket:
                return  # another window has taken the needle
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


async def _send_bands(window: Window, socket: web.WebSocketResponse) -> None:
    """Send the fit's band of the needle as it stands, again and again when it has moved."""
    sent: Any = None
    while True:
        trial = window.trial
        spread, number = trial.viewed_scene.spread, (trial.name, trial.steering.number)
        if spread is not None and number != sent:
            sent, steering = number, trial.steering
            found = await asyncio.to_thread(
                compute_band, spread, trial.scene.needle, steering.now.tissue, steering.input_path(),
                trial.scene.rules, steering.first_cell,
            )  # fmt: skip
            if trial is window.trial:
                await _send(socket, [band_message(number[1], found)])
        await asyncio.sleep(BAND_INTERVAL_S)
