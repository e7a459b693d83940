"""The OpenIGTLink side of a tracked needle: what is streamed, what is taken, and the connections.

`pyigtl` packs and unpacks messages. Its own server is not used: it reads a body of any announced size, checks
no checksum, serves one client, and takes over the process's signals.

No message of this program is a motion command, and nothing is sent to a server that it connects to itself.
"""

import asyncio
import json
import struct
import time
from contextlib import suppress
from time import monotonic

import numpy as np
from pyigtl.messages import (
    CRC64,
    MessageBase,
    PointMessage,
    PolyDataMessage,
    StringMessage,
    TransformMessage,
)
from scipy.spatial.transform import Rotation

from needlefit.arrays import Floats
from needlefit.errors import ConfigError, NeedlefitError
from needlefit.mechanics.shape import compute_positions
from needlefit.studies.needle_placement import NEEDLE_POINTS
from needlefit.viewer.overlays import NeedleBand, compute_band
from needlefit.viewer.tracking import TrackedTrial

MAX_PEERS = 8

MAX_BODY_BYTES = 16 * 1024  #: largest body that is read; a transform has 48 bytes
#: largest body that is skipped, such as an image; a larger one is no message, and ends the connection
MAX_SKIPPED_BYTES = 64 * 1024 * 1024
#: time after which a peer is dropped that stops within a message, or does not read what it is sent
STALLED_S = 5.0
MAX_WAITING_BYTES = 256 * 1024  #: unsent bytes beyond which a peer misses messages
#: shortest time between two poses sent, and two bands; and the longest between two messages
SEND_INTERVAL_S, BAND_INTERVAL_S, REPEAT_INTERVAL_S = 1 / 60, 0.15, 1.0
RECONNECT_INTERVAL_S = 1.0
#: messages per second that a peer may send, and how many may arrive at once after a pause
MAX_MESSAGES_PER_S, MAX_BURST_MESSAGES = 1000.0, 2000.0
HEADER_VERSIONS = (1, 2)  #: of OpenIGTLink 1 and 2, and of 3
_POSITION = {12: struct.Struct(">3f"), 28: struct.Struct(">7f")}
_CHECKSUM = struct.Struct(">Q")


class OpenIGTLinkServer:
    """Streams a tracked needle to all peers, and takes the poses that they send; port 0: a free one."""

    def __init__(self, tracked: TrackedTrial, host: str, port: int) -> None:
        self.tracked, self.address = tracked, (host, port)  # where it listens, once it serves
        self._peers: dict[asyncio.StreamWriter, float] = {}  # since when it reads nothing; 0: it does
        self._tasks: set[asyncio.Task[None]] = set()
        self._conversations: set[asyncio.Task[None]] = set()
        self._changed = asyncio.Event()

    async def begin(self) -> None:
        """Serve from now on; ConfigError if the address cannot be used."""
        try:
            self._server = await asyncio.start_server(self._attend, *self.address)
        except (OSError, OverflowError) as error:
            raise ConfigError(
                f"{self.address[0]}:{self.address[1]} cannot be used: {error}",
                where="--openigtlink",
                expected="a free port from 1024 to 65535, and an address of this machine",
                fix="name another port; 0 takes a free one",
            ) from error
        self.address = self._server.sockets[0].getsockname()[:2]
        jobs = [self._drive, self._send_bands, *([self._connect] if self.tracked.record.server else [])]
        for job in jobs:
            self._tasks.add(task := asyncio.create_task(job()))
            task.add_done_callback(_report_failure)

    async def end(self) -> None:
        """Serve no more; every connection is closed."""
        self._server.close()
        for task in self._tasks:
            task.cancel()
        for writer in list(
            self._peers
        ):  # their tasks end by themselves: asyncio prints cancelled ones as faults
            self._drop(writer)
        await asyncio.gather(*self._tasks, *self._conversations, return_exceptions=True)

    async def _attend(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one peer that has connected."""
        if len(self._peers) >= MAX_PEERS:
            writer.close()
            return
        task = asyncio.current_task()
        assert task is not None
        self._conversations.add(task)
        self._peers[writer] = 0.0
        self.tracked.count_peers(1)
        try:
            self._send(writer, pack_needle(self.tracked) + self._pack_status())
            await self._listen(reader)
        finally:
            self._conversations.discard(task)
            self._drop(writer)

    async def _connect(self) -> None:
        """Take poses of a server, and connect again when it was lost; nothing is sent to it."""
        host, _, port = self.tracked.record.server.rpartition(":")
        while True:
            with suppress(OSError, TimeoutError):
                async with asyncio.timeout(STALLED_S):
                    reader, writer = await asyncio.open_connection(host, int(port))
                self.tracked.count_peers(1)
                try:
                    await self._listen(reader)
                finally:
                    self.tracked.count_peers(-1)
                    writer.close()
            await asyncio.sleep(RECONNECT_INTERVAL_S)

    async def _listen(self, reader: asyncio.StreamReader) -> None:
        """Take messages until the peer goes, or sends what is none."""
        pace = RateLimit()
        with suppress(OSError, EOFError, TimeoutError, ValueError):
            while True:
                first = await reader.readexactly(1)  # a peer may send nothing, but not half a header
                async with asyncio.timeout(STALLED_S):
                    header = first + await reader.readexactly(MessageBase.IGTL_HEADER_SIZE - 1)
                fields = MessageBase.parse_header(header)
                size, kind = fields["body_size"], fields["message_type"]
                if fields["header_version"] not in HEADER_VERSIONS or size > MAX_SKIPPED_BYTES:
                    raise ValueError("this is no OpenIGTLink header")
                while not pace.allows():  # the peer waits, and what it sends grows old
                    await asyncio.sleep(0.01)
                pose = None
                if kind in ("TRANSFORM", "POSITION", "POINT") and size <= MAX_BODY_BYTES:
                    async with asyncio.timeout(STALLED_S):
                        body = await reader.readexactly(size)
                    pose = (
                        read_pose(fields, body) if _CHECKSUM.unpack(header[-8:])[0] == CRC64(body) else None
                    )
                else:
                    while size > 0:  # each `MAX_BODY_BYTES` of a body that is not kept must come in time
                        async with asyncio.timeout(STALLED_S):
                            size -= len(await reader.readexactly(min(size, MAX_BODY_BYTES)))
                if pose is None:
                    self.tracked.ignored += 1
                    continue
                sent, name = fields["timestamp"], fields["device_name"]
                if self.tracked.take(name, pose, sent, time.time(), directed=kind != "POINT"):
                    self._changed.set()

    async def _drive(self) -> None:
        """Move the needle when poses come, stream it, and estimate its parameters."""
        shown = number = None
        repeated = -REPEAT_INTERVAL_S
        while True:
            with suppress(TimeoutError):
                async with asyncio.timeout(0.1):
                    await self._changed.wait()
            self._changed.clear()
            began, tracked = monotonic(), self.tracked
            wanted = tracked.advance(time.time())
            if (now := (tracked.trial.name, tracked.trial.steering.number)) != shown:
                self._broadcast(pack_needle(self.tracked))
                shown = now
            if tracked.number != number or began - repeated >= REPEAT_INTERVAL_S:
                needle = b"" if tracked.number != number else pack_needle(tracked)
                self._broadcast(needle + self._pack_status())
                number, repeated = tracked.number, began
            if wanted:
                trial = tracked.trial
                with suppress(NeedlefitError):
                    tracked.apply(await asyncio.to_thread(tracked.compute_estimate), trial)
                self._changed.set()
            await asyncio.sleep(max(0.0, began + SEND_INTERVAL_S - monotonic()))

    async def _send_bands(self) -> None:
        """Stream the band of the needle as it stands, when it has moved and somebody listens."""
        sent = None
        while True:
            trial = self.tracked.trial
            spread = trial.viewed_scene.spread
            number = (trial.name, trial.steering.number, id(spread), len(self._peers))
            if spread is not None and self._peers and number != sent:
                sent = number
                band = await asyncio.to_thread(compute_band, trial.insertion)
                if band is not None:
                    self._broadcast(pack_band(self.tracked, band))
            await asyncio.sleep(BAND_INTERVAL_S)

    def _pack_status(self) -> bytes:
        status = json.dumps(self.tracked.status(time.time()), allow_nan=False)
        return _pack(StringMessage(status, device_name="NeedlefitStatus"))

    def _broadcast(self, packed: bytes) -> None:
        for writer in list(self._peers):
            self._send(writer, packed)

    def _send(self, writer: asyncio.StreamWriter, packed: bytes) -> None:
        """Send to a peer that keeps up; one that has not read for long is dropped."""
        if writer.transport.get_write_buffer_size() <= MAX_WAITING_BYTES:
            self._peers[writer] = 0.0
            writer.write(packed)
        elif not self._peers[writer]:
            self._peers[writer] = monotonic()
        elif monotonic() - self._peers[writer] > STALLED_S:
            writer.transport.abort()
            self._drop(writer)

    def _drop(self, writer: asyncio.StreamWriter) -> None:
        if self._peers.pop(writer, None) is not None:
            self.tracked.count_peers(-1)
            writer.close()


class RateLimit:
    """The limit of a peer's messages: `MAX_MESSAGES_PER_S`, `MAX_BURST_MESSAGES` after a pause."""

    def __init__(self) -> None:
        self._left, self._at = MAX_BURST_MESSAGES, monotonic()

    def allows(self) -> bool:
        now = monotonic()
        # A token bucket: the allowance grows with time up to the burst, and each message takes one.
        self._left = min(MAX_BURST_MESSAGES, self._left + MAX_MESSAGES_PER_S * (now - self._at))
        self._at = now
        if self._left < 1:
            return False
        self._left -= 1
        return True


def _report_failure(task: asyncio.Task[None]) -> None:
    """Print a fault of the program at once, not when it ends."""
    if not task.cancelled() and (error := task.exception()) is not None:
        task.get_loop().call_exception_handler({"message": "OpenIGTLink has stopped", "exception": error})


def read_pose(fields: dict[str, object], body: bytes) -> Floats | None:
    """Return the pose (4, 4) in a message; None if there is none."""
    kind = fields["message_type"]
    matrix = np.eye(4)
    try:
        if kind == "POSITION":  # pyigtl reads points under this name
            values = _POSITION[len(body)].unpack(body)
            matrix[:3, 3] = values[:3]
            if len(values) > 3:
                matrix[:3, :3] = Rotation.from_quat(values[3:]).as_matrix()  # ValueError of a zero one
            return matrix
        message = MessageBase.create_message(kind)
        message.unpack(fields, body)
        # PLUS and 3D Slicer send on what a tracker does not see, with its last place and this remark.
        if message.metadata.get("TransformStatus", "OK") != "OK":
            return None
        if kind == "TRANSFORM":
            return np.asarray(message.matrix, dtype=np.float64)
        matrix[:3, 3] = message.positions[0]
    except (struct.error, ValueError, LookupError, TypeError, AttributeError):
        return None
    return matrix


def pack_needle(tracked: TrackedTrial) -> bytes:
    """Return the centreline as POLYDATA and the tip as TRANSFORM, RAS, mm.

    The tip's z axis points along the needle, x to the side to which the bevel turns the cut.
    """
    now = tracked.trial.steering.now
    points = compute_positions(now.shape, np.linspace(now.shape.x[0], now.shape.x[-1], NEEDLE_POINTS))
    rotation, side = float(now.shape.slope[-1]), now.step.bevel.side
    along = [np.cos(rotation), np.sin(rotation), 0.0]
    across = [-side * np.sin(rotation), side * np.cos(rotation), 0.0]
    x, z = tracked.to_ras_direction(across), tracked.to_ras_direction(along)
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    matrix[:3, 3] = tracked.to_ras(points[-1:])[0]
    tip = _pack(TransformMessage(matrix, device_name="NeedlefitTip"))
    return _pack_line(tracked.to_ras(points), "NeedlefitNeedle") + tip


def pack_band(tracked: TrackedTrial, band: NeedleBand) -> bytes:
    """Return the outline of the 95 % band as POLYDATA, and its two ends at the tip as POINT, RAS, mm."""
    low, high = (np.column_stack([band.x, edge]) for edge in (band.low, band.high))
    outline = np.vstack([low, high[::-1], low[:1]])
    ends = PointMessage(
        tracked.to_ras(np.vstack([low[-1:], high[-1:]])),
        names=["tip 2.5 %", "tip 97.5 %"],
        device_name="NeedlefitTipBand",
    )
    return _pack_line(tracked.to_ras(outline), "NeedlefitBand") + _pack(ends)


def _pack_line(points: Floats, name: str) -> bytes:
    line = np.array([len(points), *range(len(points))])
    return _pack(PolyDataMessage(points=points, lines=line, device_name=name))


def _pack(message: MessageBase) -> bytes:
    packed: bytes = message.pack()
    return packed
