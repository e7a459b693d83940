"""The routes of the page on which a scan is examined and corrected."""

import asyncio
import json
from collections.abc import Callable
from typing import Any

from aiohttp import web

from needlefit.errors import NeedlefitError
from needlefit.viewer.scans.session import ScanSession
from needlefit.viewer.serving.connections import AccessControl
from needlefit.viewer.serving.messages import parse_json


class ScanPage:
    """The page of one scan; what takes long runs in a thread, one examination at a time."""

    index = "scan.html"

    def __init__(self, session: ScanSession) -> None:
        self.session = session
        self._examining = asyncio.Lock()

    def add_routes(self, app: web.Application, _: AccessControl) -> None:
        """Add what the page asks for."""
        for name in ("describe", "cut", "again", "save"):
            app.router.add_post(f"/scan/{name}", getattr(self, name))

    async def describe(self, _: web.Request) -> web.Response:
        """Return everything found and corrected."""
        async with self._examining:
            return _as_json(await asyncio.to_thread(self.session.describe))

    async def cut(self, request: web.Request) -> web.Response:
        """Return a slice as PNG."""
        content = await _read(request)
        found = await self._run(lambda: self.session.cut(content))
        return web.Response(body=found, content_type="image/png")

    async def again(self, request: web.Request) -> web.Response:
        """Examine the scan again with corrections; return what was found then."""
        content = await _read(request)
        async with self._examining:
            await self._run(lambda: self.session.again(content))
            return _as_json(await asyncio.to_thread(self.session.describe))

    async def save(self, request: web.Request) -> web.Response:
        """Write the corrected scan as a table of scans."""
        content = await _read(request)
        async with self._examining:
            path = await self._run(lambda: self.session.save_shown(content))
        return _as_json({"table": str(path), "command": self.session.command(path)})

    async def _run(self, work: Callable[[], Any]) -> Any:  # noqa: ANN401 - what `work` returns
        try:
            return await asyncio.to_thread(work)
        except (NeedlefitError, OSError) as error:
            parts = {name: getattr(error, name, "") for name in ("what", "where", "expected", "fix")}
            text = json.dumps({**parts, "what": parts["what"] or str(error)})
            raise web.HTTPUnprocessableEntity(text=text, content_type="application/json") from error


async def _read(request: web.Request) -> Any:  # noqa: ANN401 - JSON
    try:
        return await request.json(loads=parse_json)
    except ValueError:  # no JSON, or of no known charset
        raise web.HTTPBadRequest(text="the request is no JSON") from None


def _as_json(content: dict[str, Any]) -> web.Response:
    return web.json_response(content)
