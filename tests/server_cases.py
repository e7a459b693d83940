"""A page of the viewer served beside its test, and a client."""

import asyncio
from contextlib import asynccontextmanager

import aiohttp

from needlefit.viewer.server import serve


@asynccontextmanager
async def served(page):
    """Serve a page; yield its access control and a client."""
    opened, end = asyncio.get_running_loop().create_future(), asyncio.Event()
    server = asyncio.create_task(serve(page, 0, opened.set_result, end.wait))
    async with aiohttp.ClientSession() as client:
        yield await opened, client
    end.set()
    await server
