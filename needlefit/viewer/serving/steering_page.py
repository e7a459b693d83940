"""The routes of the interactive simulation: its WebSocket, and files to download."""

import asyncio
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from multiprocessing import get_context
from typing import TYPE_CHECKING

from aiohttp import web

from needlefit.errors import NeedlefitError
from needlefit.viewer.export import EXPORT_TYPES, export
from needlefit.viewer.overlay.slice import read_slice
from needlefit.viewer.serving.connections import AccessControl, Connections
from needlefit.viewer.serving.messages import parse_json
from needlefit.viewer.serving.trials import InteractiveTrial, TrialRegistry

if TYPE_CHECKING:
    from needlefit.viewer.serving.openigtlink import OpenIGTLinkServer


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
            content = await request.json(loads=parse_json)
            trial = self.trials.known(content["needle"])
        except (ValueError, LookupError, TypeError):  # no JSON, of no known charset, or about no needle
            trial = None
        if trial is None:
            raise web.HTTPNotFound(text="there is no such needle: reload the page")
        return trial


class SteeringPage:
    """The page of the interactive simulation, and the OpenIGTLink server beside it, if there is one."""

    index = "index.html"

    def __init__(self, trials: TrialRegistry, openigtlink: "OpenIGTLinkServer | None" = None) -> None:
        self.trials, self.openigtlink = trials, openigtlink

    def add_routes(self, app: web.Application, access: AccessControl) -> None:
        """Add the WebSocket, exports and slices."""
        tracked = None
        if self.openigtlink is not None:
            tracked = self.openigtlink.tracked
            app.cleanup_ctx.append(self.openigtlink.run)
        connections, files = Connections(access, self.trials, tracked), FileRoutes(self.trials)
        app.router.add_get("/ws", connections.attend)
        app.router.add_post("/export/{kind}", files.make)
        app.router.add_post("/slice", files.cut)
        app.on_shutdown.extend((connections.leave, files.leave))
