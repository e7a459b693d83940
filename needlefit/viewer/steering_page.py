"""The windows of the interactive simulation: what they send, ask for, and what the program finds for them."""

import asyncio
import json
import traceback
from collections.abc import Coroutine
from typing import Any

from aiohttp import WSCloseCode, WSMsgType, web

from needlefit.viewer.messages import compile_asked_law, read_message
from needlefit.viewer.trial import InteractiveTrial, StepOrderError
from needlefit.viewer.trials import TrialRegistry
from needlefit.viewer.window import Reply, Window

SLOW = ("show",)  #: messages that read a dataset: other windows go on meanwhile


class SteeringPage:
    """All windows: each has a WebSocket, and each needle one window, the newest."""

    def __init__(self, trials: TrialRegistry) -> None:
        self.trials = trials
        self._sockets: dict[str, web.WebSocketResponse] = {}

    async def end(self) -> None:
        """Say goodbye to every window."""
        for socket in list(self._sockets.values()):
            await _send(socket, {"kind": "bye", "what": "the server was stopped"})
            await socket.close(code=WSCloseCode.GOING_AWAY)

    async def answer(self, name: str, content: dict[str, Any]) -> web.Response:
        """Return a file made of a recording, or the law of all layers."""
        trial = self.trials.known(str(content.get("needle")))
        if trial is None:
            raise web.HTTPNotFound(text="there is no such needle: reload the page")
        kind = name.removeprefix("export/")
        if name == "law":
            return web.json_response(
                await asyncio.to_thread(compile_asked_law, trial.scene.tissue, content.get("shape"))
            )
        from needlefit.viewer.export import EXPORT_TYPES, export

        if kind not in EXPORT_TYPES:
            raise web.HTTPNotFound(text=f"there is no {name} of this needle")
        trial.recorder.begin()
        found = await asyncio.to_thread(export, trial.recorder.path, kind)
        return web.Response(body=found, content_type=EXPORT_TYPES[kind])

    async def converse(self, socket: web.WebSocketResponse, hello: str) -> None:
        """Serve a window that has the token, for as long as it is there; `hello` is its first message."""
        first = read_message(hello)
        window = Window(self.trials, self.trials.open(first.text("needle")))
        before, self._sockets[window.trial.name] = self._sockets.get(window.trial.name), socket
        if before is not None:
            await _send(before, {"kind": "taken"})
            await before.close()
        work: dict[str, asyncio.Task[None]] = {}
        try:
            async with window.trial.lock:
                replies = list(window.answer(first))
            await _send(socket, *replies)
            await self._listen(window, socket, work)
        finally:
            window.closed = True
            for task in work.values():
                task.cancel()
            self._let_go(window.trial, socket)

    async def _listen(
        self, window: Window, socket: web.WebSocketResponse, work: dict[str, asyncio.Task[None]]
    ) -> None:
        async for frame in socket:
            if frame.type is not WSMsgType.TEXT:
                await socket.close(code=WSCloseCode.UNSUPPORTED_DATA)
                return
            message, trial = read_message(frame.data), window.trial
            async with trial.lock:
                if self._sockets.get(trial.name) is not socket:
                    return  # another window has taken the needle
                try:
                    replies = window.answer(message)
                    done = await asyncio.to_thread(list, replies) if message.do in SLOW else list(replies)
                except StepOrderError as error:  # the page begins anew with what is recorded
                    await socket.close(code=WSCloseCode.TRY_AGAIN_LATER, message=str(error).encode())
                    return
            if window.trial is not trial:
                self._let_go(trial, socket)
                self._sockets[window.trial.name] = socket
            await _send(socket, *done)
            for kind in window.orders:
                if kind not in work or work[kind].done():
                    carrying_out = _carry_out(window, kind, socket)
                    work[kind] = asyncio.create_task(_close_if_failed(carrying_out, socket))

    def _let_go(self, trial: InteractiveTrial, socket: web.WebSocketResponse) -> None:
        """Note that a window steers a needle no more, unless another one has taken it."""
        if self._sockets.get(trial.name) is socket:
            del self._sockets[trial.name]


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


async def _carry_out(window: Window, kind: str, socket: web.WebSocketResponse) -> None:
    """Carry out the newest order of a kind until there is none, and send what is found for its needle."""
    while (replies := window.orders.pop(kind, None)) is not None:
        trial = window.trial
        async with trial.lock:
            await asyncio.to_thread(next, replies, None)  # it reads the needle
        while (reply := await asyncio.to_thread(next, replies, None)) and window.trial is trial:
            await _send(socket, reply)
