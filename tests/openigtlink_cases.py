"""A page with an OpenIGTLink server beside it, a client of the library, and poses of a simulated needle."""

import asyncio
import contextlib
import socket
import struct
import time
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from functools import cache

import aiohttp
import numpy as np
import pyigtl
from server_cases import served as serving

from needlefit.geometry.frames import to_lps
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import Session
from needlefit.mechanics.shape import compute_positions
from needlefit.schemas.tracker import TrackerRecord
from needlefit.viewer.openigtlink import OpenIGTLinkServer
from needlefit.viewer.opening import open_target
from needlefit.viewer.server import AccessControl, LoadingPage
from needlefit.viewer.steering_page import SteeringPage
from needlefit.viewer.tracking import TrackedTrial
from needlefit.viewer.trials import TrialRegistry

IDENTITY = tuple(map(tuple, np.eye(4).tolist()))


def record(**changes) -> TrackerRecord:
    changes = changes if "markers" in changes else {"tracker_to_ras": IDENTITY} | changes
    return TrackerRecord.model_validate({"schema": 1, **changes})


@dataclass
class Served:
    access: AccessControl
    server: OpenIGTLinkServer
    trials: TrialRegistry
    client: aiohttp.ClientSession

    @property
    def tracked(self) -> TrackedTrial:
        return self.server.tracked

    @property
    def depth(self) -> float:
        return self.tracked.trial.steering.now.step.depth


@asynccontextmanager
async def served(folder, name="phantom2", **changes):
    viewed_scene = open_target(name)
    trials = TrialRegistry(viewed_scene, folder, lambda insertion: open_target(viewed_scene.name, insertion))
    server = OpenIGTLinkServer(TrackedTrial(record(**changes), trials), "127.0.0.1", 0)
    page = LoadingPage(lambda show: SteeringPage(trials, server))
    async with serving(page) as (access, client):
        await page.ended.wait()
        yield Served(access, server, trials, client)


def connect(port: int) -> socket.socket:
    """Return a connection to a server that may still be loading."""
    for _ in range(600):
        with contextlib.suppress(ConnectionRefusedError):
            return socket.create_connection(("127.0.0.1", port))
        time.sleep(0.1)
    raise TimeoutError(port)


@contextlib.contextmanager
def connected(port: int):
    client = pyigtl.OpenIGTLinkClient("127.0.0.1", port)
    try:
        yield client
    finally:
        client.stop()


async def until(condition, seconds: float = 60.0):
    """Wait until a condition holds."""
    async with asyncio.timeout(seconds):
        while not (found := condition()):
            await asyncio.sleep(0.005)
    return found


def transform(point, axis=(1.0, 0.0, 0.0)) -> np.ndarray:
    """Return the pose (4, 4) in RAS of a device at a point (x, y) of C, of a scene whose C is its world."""
    matrix = np.eye(4)
    z = to_lps(np.array(axis) / np.linalg.norm(axis), "RAS")
    x = np.cross([0.0, 0.0, 1.0], z)
    matrix[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    matrix[:3, 3] = to_lps(np.array([*point, 0.0]), "RAS")
    return matrix


def pack(name: str, matrix, **about) -> bytes:
    return pyigtl.TransformMessage(matrix, device_name=name, **about).pack()


@cache
def tip_path(mu_factor: float = 1.0, b_factor: float = 1.0, depth: int = 60) -> np.ndarray:
    """Return the tips (n, 2) of a needle of the scene phantom2 with other parameters, each millimetre."""
    scene = Scene.from_record(open_target("phantom2").record, "phantom2")
    bevel = replace(scene.steps[0].bevel, offset=b_factor * scene.steps[0].bevel.offset)
    tissue = replace(scene.tissue, mu=mu_factor * scene.tissue.mu)
    session = Session(scene.needle, tissue, bevel, 1.0, scene.steps[0].controls, scene.rules)
    tips = []
    for _ in range(depth):
        shape = session.step(1.0)
        tips.append(compute_positions(shape, shape.x[-1:])[0])
    return np.array(tips)


def read_polydata(content: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Return points (N, 3) and the first line of a POLYDATA body, as its specification lays them out."""
    sizes = struct.unpack(">10I", content[:40])
    points = np.frombuffer(content, ">f4", 3 * sizes[0], 40).reshape(-1, 3)
    assert sizes[1] == 0 and sizes[3] == 1 and sizes[5:] == (0,) * 5
    lines = np.frombuffer(content, ">u4", sizes[4] // 4, 40 + 12 * sizes[0])
    assert len(content) == 40 + 12 * sizes[0] + sizes[4] and lines[0] == len(lines) - 1
    return points, lines[1:]
