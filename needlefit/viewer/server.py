"""The local server of a page: access control, and the files of the page."""

import asyncio
import json
import logging
import secrets
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from socket import create_server
from typing import TYPE_CHECKING

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError
from aiohttp.typedefs import Handler

from needlefit.errors import ConfigError, NeedlefitError
from needlefit.project.json_values import parse_json_text

if TYPE_CHECKING:
    from needlefit.viewer.steering_page import SteeringPage

PAGE = Path(__file__).parent / "page"
#: what the page needs of `mechanics/native`, under the address that its modules import
KERNEL = Path(__file__).parents[1] / "mechanics" / "native"
KERNEL_FILES = ("needle.js", "memory.js", "kernel.wasm")
LOOPBACK = "127.0.0.1"
MAX_MESSAGE_BYTES = 64 * 1024  #: size limit of a message; the largest from the page are steps
TOKEN_TIMEOUT_S = 10.0  #: time in which a window must send its token, s
REQUEST_TIMEOUT_S = 10.0  #: time in which a request must have come whole, s
CLOSE_NO_TOKEN = 4401  #: code for closing a socket of which the token is missing or wrong

#: headers of every answer: the page runs only code of this server, and connects only to it
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; "
    "img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


@dataclass(frozen=True)
class AccessControl:
    """The rules by which a request is accepted: host, origin and token."""

    port: int  #: on which the server listens
    #: made anew for every server
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"{host}:{self.port}" for host in (LOOPBACK, "localhost"))

    @property
    def address(self) -> str:
        """The address of the page; the token follows `#`, a part that browsers send to no server."""
        return f"http://{LOOPBACK}:{self.port}/#token={self.token}"

    def is_token(self, token: object) -> bool:
        """Whether a text is the token; the comparison takes the same time for every text."""
        # An ordinary comparison ends at the first difference; its duration would reveal how much of a guess
        # is right. Headers that are no UTF-8 come with surrogates.
        return isinstance(token, str) and secrets.compare_digest(
            token.encode(errors="surrogatepass"), self.token.encode()
        )


def _is_own_fault(record: logging.LogRecord) -> bool:
    """Return whether a logged error is one of this program, not a request that is no HTTP."""
    error = record.exc_info[1] if record.exc_info else None
    foreign = HttpProcessingError, web.RequestPayloadError, asyncio.InvalidStateError
    return not isinstance(error, foreign)


async def serve(
    page: "SteeringPage",
    port: int,
    ready: Callable[[AccessControl], None],
    stop: Callable[[], Awaitable[None]],
) -> None:
    """Serve a page on the loopback until `stop` returns; ConfigError if the port is taken.

    `port` 0 is one that is free. `ready` is called once the page can be opened; `stop` is awaited meanwhile.
    """
    # The socket is opened before the address is made: port 0 gets its number only then.
    try:
        listening = create_server((LOOPBACK, port))
    except (OSError, OverflowError) as error:
        raise ConfigError.of(f"""port {port} cannot be used: {getattr(error, "strerror", error)}
            expected: a free port from 1024 to 65535
            fix: leave --port out: a free one is then taken
            where: --port""") from error
    access = AccessControl(listening.getsockname()[1])
    app = _make_application(access, page)
    logging.getLogger("aiohttp.server").addFilter(_is_own_fault)
    runner = web.AppRunner(
        app,
        access_log=None,
        shutdown_timeout=2.0,
        keepalive_timeout=REQUEST_TIMEOUT_S,
        lingering_time=1.0,  # s, for the rest of a request that was answered
    )
    try:
        await runner.setup()
        await web.SockSite(runner, listening).start()
        ready(access)
        await stop()
    finally:
        await runner.cleanup()
        listening.close()  # also where the setup failed before anything was served


def _make_application(access: AccessControl, page: "SteeringPage") -> web.Application:
    """Return the routes of the page."""

    @web.middleware
    async def guard(request: web.Request, handler: Handler) -> web.StreamResponse:
        """Keep out who calls this server by another name, and who has no token where one is due."""
        if request.headers.get("Host", "") not in access.names:
            raise web.HTTPMisdirectedRequest(text="this server answers to 127.0.0.1 and localhost alone")
        if request.method == "POST":
            scheme, _, token = request.headers.get("Authorization", "").partition(" ")
            if scheme != "Bearer" or not access.is_token(token):
                raise web.HTTPForbidden(text="the token is missing or wrong: open the address as printed")
        own = [f"http://{name}" for name in access.names]
        if (request.method == "POST" or request.path == "/ws") and request.headers.get("Origin") not in own:
            raise web.HTTPForbidden(text="only the page that this server gave out may ask for that")
        try:
            async with asyncio.timeout(REQUEST_TIMEOUT_S):
                await request.read()  # kept for the handler
        except TimeoutError:
            raise web.HTTPRequestTimeout(text="the request was not sent to its end") from None
        except (ConnectionError, web.RequestPayloadError):
            raise web.HTTPBadRequest(text="the request was cut, or is not encoded as it states") from None
        try:
            return await handler(request)
        except OSError:
            if not request.path.startswith("/page/"):
                raise
            raise web.HTTPNotFound from None  # the path is no file name

    async def send_index(_: web.Request) -> web.FileResponse:
        return web.FileResponse(PAGE / "index.html")

    async def answer(request: web.Request) -> web.Response:
        """Return what the page asks for; a fault is one that it shows."""
        try:
            content = await request.json(loads=parse_json_text)
            if not isinstance(content, dict):
                raise ValueError
        except (ValueError, LookupError):  # no JSON, or of no known charset
            raise web.HTTPBadRequest(text="the request is no JSON") from None
        try:
            return await page.answer(request.path.strip("/"), content)
        except (NeedlefitError, OSError) as error:
            fault = error if isinstance(error, NeedlefitError) else NeedlefitError(str(error))
            text = json.dumps({name: getattr(fault, name) for name in ("what", "where", "expected", "fix")})
            raise web.HTTPUnprocessableEntity(text=text, content_type="application/json") from error

    async def end(_: web.Application) -> None:
        await page.end()

    async def add_headers(_: web.Request, response: web.StreamResponse) -> None:
        response.headers.update(HEADERS)

    app = web.Application(middlewares=[guard], client_max_size=MAX_MESSAGE_BYTES)
    app.router.add_get("/", send_index)
    app.router.add_static("/page", PAGE)
    app.router.add_post("/{name:.+}", answer)
    app.on_response_prepare.append(add_headers)
    app.router.add_get("/ws", partial(_attend, access, page))
    app.router.add_get("/mechanics/native/{name}", _send_kernel)
    app.on_shutdown.append(end)
    return app


async def _send_kernel(request: web.Request) -> web.FileResponse:
    """Return a file of the kernel, which the page runs as WebAssembly."""
    name = request.match_info["name"]
    if name not in KERNEL_FILES:
        raise web.HTTPNotFound
    return web.FileResponse(KERNEL / name)


async def _attend(access: AccessControl, page: "SteeringPage", request: web.Request) -> web.WebSocketResponse:
    """Serve one window that sends the token first."""
    socket = web.WebSocketResponse(
        timeout=2.0, max_msg_size=MAX_MESSAGE_BYTES, heartbeat=20.0, compress=False
    )
    await socket.prepare(request)
    try:
        hello = await socket.receive_str(timeout=TOKEN_TIMEOUT_S)
        content = parse_json_text(hello)
    except (TypeError, ValueError, TimeoutError):
        content = None
    if isinstance(content, dict) and access.is_token(content.get("token")):
        await page.converse(socket, hello)
    else:
        await socket.close(code=CLOSE_NO_TOKEN, message=b"the token is missing or wrong")
    return socket
