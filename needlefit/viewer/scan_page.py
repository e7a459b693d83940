"""The page of a scan: requests to examine, correct and save it."""

import asyncio
import json
from collections.abc import Callable
from typing import Any

from aiohttp import web

from needlefit.errors import NeedlefitError
from needlefit.project.json_values import parse_json
from needlefit.viewer.messages import encode_fault
from needlefit.viewer.scan_session import ScanSession
from needlefit.viewer.server import AccessControl


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
            error = self.session.found.error
        saved = {"table": str(path), "command": self.session.command(path)}
        return web.json_response(saved | {"refused": error and error.what})

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
