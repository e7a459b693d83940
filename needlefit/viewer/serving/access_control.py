"""Who may come in: this machine's own page, with the token, in reasonable pieces.

Any web page that is open in the same browser can try to reach a server on the loopback. It is kept out by
three things: the name under which it calls (`Host`, against DNS that is bent to this machine), where it comes
from (`Origin`), and the token, which only the printed address holds.
"""

import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from time import monotonic

LOOPBACK = "127.0.0.1"

MAX_MESSAGE_BYTES = 16 * 1024
"""Bytes of a message: the largest that the page sends has a few hundred."""

MAX_MESSAGES_PER_S = 1000.0
"""Messages a second that a window may send; a page sends up to 250 inputs, and one for each of its frames."""

MAX_BURST_MESSAGES = 2000.0
"""Messages that may come at once after a pause."""

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
"""Of every answer: the page runs only what this server gave it, and talks to nobody else."""


@dataclass(frozen=True)
class AccessControl:
    """What a caller is measured by.

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
        """Under which this server may be called."""
        return tuple(f"{host}:{self.port}" for host in (LOOPBACK, "localhost"))

    @property
    def address(self) -> str:
        """Where the page is; the token stands behind `#`, which browsers send to nobody."""
        return f"http://{LOOPBACK}:{self.port}/#token={self.token}"

    def has_own_host(self, headers: Mapping[str, str]) -> bool:
        """Whether a request calls this server by its own name."""
        return headers.get("Host", "") in self.names

    def from_page(self, headers: Mapping[str, str]) -> bool:
        """Whether a request comes from this server's own page."""
        return headers.get("Origin", "") in tuple(f"http://{name}" for name in self.names)

    def is_token(self, token: object) -> bool:
        """Whether that is the token."""
        return isinstance(token, str) and secrets.compare_digest(token.encode(), self.token.encode())


class RateLimit:
    """How fast a window may talk: `MAX_MESSAGES_PER_S` a second, after a pause `MAX_BURST_MESSAGES` at
    once.
    """

    def __init__(self) -> None:
        self._left, self._at = MAX_BURST_MESSAGES, monotonic()

    def allows(self) -> bool:
        """Whether one more message may come now."""
        now = monotonic()
        self._left = min(MAX_BURST_MESSAGES, self._left + MAX_MESSAGES_PER_S * (now - self._at))
        self._at = now
        if self._left < 1:
            return False
        self._left -= 1
        return True
