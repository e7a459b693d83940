"""Files to take away: exports of a recording, the slice of a scan."""

import asyncio
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from multiprocessing import get_context

from aiohttp import web

from needlefit.errors import NeedlefitError
from needlefit.viewer.exports.export import KINDS, export
from needlefit.viewer.overlay.slice import slice_of
from needlefit.viewer.serving.trial import Trial
from needlefit.viewer.serving.trials import Trials


class Files:
    """Makes files while needles go on: exports by a process of its own, slices by a thread."""

    def __init__(self, trials: Trials) -> None:
        self.trials = trials
        self._pool: ProcessPoolExecutor | None = None

    async def make(self, request: web.Request) -> web.Response:
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
        except BrokenExecutor as error:
            self._pool = None  # it was killed, perhaps for want of memory; the next one begins anew
            raise web.HTTPInternalServerError(text="the program that made it was ended; try again") from error
        return web.Response(body=found, content_type=KINDS[kind])

    async def cut(self, request: web.Request) -> web.Response:
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

    async def leave(self, _: web.Application) -> None:
        """Wait for nothing that is still being made."""
        if self._pool:
            self._pool.shutdown(wait=False, cancel_futures=True)

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
