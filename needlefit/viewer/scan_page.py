"""The page of a scan: requests to examine, correct and save it."""

import asyncio
from typing import Any

from aiohttp import web

from needlefit.viewer.scan_session import ScanSession


class ScanPage:
    """The page of one scan; what takes long runs in a thread, one examination at a time."""

    index, preloads = "scan.html", ""

    def __init__(self, session: ScanSession) -> None:
        self.session = session
        self._examining = asyncio.Lock()

    async def answer(self, name: str, content: dict[str, Any]) -> web.Response:
        """Return a slice; or, after an examination or a saving, what the page then shows."""
        if name == "scan/cut":
            png = await asyncio.to_thread(self.session.cut, content)
            return web.Response(body=png, content_type="image/png")
        async with self._examining:
            match name:
                case "scan/again":
                    await asyncio.to_thread(self.session.again, content)
                case "scan/save":
                    path = await asyncio.to_thread(self.session.save_shown, content)
                    error = self.session.found.error
                    saved = {"table": str(path), "command": self.session.command(path)}
                    return web.json_response(saved | {"refused": error and error.what})
                case "scan/describe":
                    pass
                case _:
                    raise web.HTTPNotFound
            return web.json_response(await asyncio.to_thread(self.session.describe))
