"""Latency and memory of `needlefit view --openigtlink`, by a client in real sockets on this machine.

    python benchmarks/openigtlink.py [--minutes 1] [--rate 60] [--json]

Starts the command with the scene phantom 2, and sends it a base and a tip at a rate (Hz): the tip of a
simulated needle with twice the moduli and 1.3 times b, in at 10 mm/s to 100 mm and out again, over and over;
tip and base are read with errors of 0.3 mm. Latency is the time from a tip sent to the needle that comes
back, by a plain socket. Every 10 s another client connects and goes; every other one sends garbage first.
Memory is that of the command's process.
"""

import argparse
import contextlib
import json
import os
import random
import socket
import struct
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyigtl

from needlefit.geometry.frames import to_lps
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import Session
from needlefit.mechanics.shape import compute_positions
from needlefit.viewer.opening import open_target

DEPTH_MM, SPEED_MM_S, ERROR_MM = 100, 10.0, 0.3
TRACKER = "schema = 1\ntracker_to_ras = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--rate", type=float, default=60.0)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        tracker = Path(folder) / "tracker.toml"
        tracker.write_text(TRACKER)
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        command = [sys.executable, "-m", "needlefit", "view", "phantom2", "--no-browser", "--out", folder]
        command += ["--openigtlink", str(port), "--tracker", str(tracker)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
            try:
                found = measure(port, process.pid, asked.minutes, asked.rate)
            finally:
                process.terminate()
        found["recorded_mb"] = round(sum(one.stat().st_size for one in Path(folder).rglob("*.csv")) / 1e6, 1)
    print(json.dumps(found, indent=2) if asked.json else "\n".join(f"{k:24} {v}" for k, v in found.items()))


def connect(port: int) -> socket.socket:
    """Return a connection to the program, once it listens."""
    while True:
        with contextlib.suppress(ConnectionRefusedError):
            return socket.create_connection(("127.0.0.1", port))
        time.sleep(0.1)


def measure(port: int, pid: int, minutes: float, rate: float) -> dict[str, object]:
    """Return latencies (ms), memory (MB) minute by minute, and what the program reported at the end."""
    path, rng = simulate_tips(), np.random.default_rng(3)
    latencies, memory, status = [], [], {}
    began, visited, minute, sent = time.monotonic(), 0, 0, 0
    with connect(port) as link:
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        received = Receiver(link)
        while (now := time.monotonic() - began) < 60 * minutes:
            place = SPEED_MM_S * now % (2 * DEPTH_MM)
            depth = min(place, 2 * DEPTH_MM - place)
            tip = np.array([np.interp(depth, path[:, 0], path[:, k]) for k in (1, 2)])
            tip += ERROR_MM * rng.standard_normal(2)
            base = pack("Base", np.array([depth - 150.0, 0.0]) + ERROR_MM * rng.standard_normal(2))
            asked = time.perf_counter()
            link.sendall(base + pack("Tip", tip))
            sent += 2
            arrived = received.wait("NeedlefitTip", 0.8 / rate)
            if arrived is not None:
                latencies.append(1e3 * (arrived - asked))
            status = received.status or status
            if now > 10 * visited:
                visit(port, visited)
                visited += 1
            if now >= 60 * minute:
                memory.append(round(read_memory(pid), 1))
                minute += 1
            time.sleep(max(0.0, 1 / rate - (time.perf_counter() - asked)))
    memory.append(round(read_memory(pid), 1))
    return {
        "minutes": round(minutes, 1),
        "messages_sent": sent,
        "needles_received": len(latencies),
        "latency_median_ms": round(float(np.median(latencies)), 1),
        "latency_95_ms": round(float(np.percentile(latencies, 95)), 1),
        "latency_greatest_ms": round(max(latencies), 1),
        "memory_mb": memory,
        "other_clients": visited,
        "readings": status.get("readings"),
        "b_mm": status.get("offset_mm"),
        "frozen": status.get("frozen"),
        "load": round(os.getloadavg()[0], 1),
    }


def simulate_tips() -> np.ndarray:
    """Return depth and tip (n, 3) of the needle that is tracked, mm."""
    scene = Scene.from_record(open_target("phantom2").record, "phantom2")
    bevel = replace(scene.steps[0].bevel, offset=1.3 * scene.steps[0].bevel.offset)
    tissue = replace(scene.tissue, mu=2.0 * scene.tissue.mu)
    session = Session(scene.needle, tissue, bevel, 1.0, scene.steps[0].controls, scene.rules)
    rows = [(0.0, 0.0, 0.0)]
    for depth in range(1, DEPTH_MM + 1):
        shape = session.step(1.0)
        rows.append((depth, *compute_positions(shape, shape.x[-1:])[0]))
    return np.array(rows)


def pack(name: str, point) -> bytes:
    """Return a pose in the plane of the needle, its z axis along x, as RAS."""
    matrix = np.eye(4)
    matrix[:3, 2], matrix[:3, 0], matrix[:3, 1] = [-1, 0, 0], [0, 0, 1], [0, 1, 0]
    matrix[:3, 3] = to_lps(np.array([*point, 0.0]), "RAS")
    return pyigtl.TransformMessage(matrix, device_name=name).pack()


class Receiver:
    """Reads messages off a socket: when each device was last heard, and the last status."""

    def __init__(self, link: socket.socket) -> None:
        self.link, self.waiting, self.status = link, b"", None

    def wait(self, device: str, seconds: float) -> float | None:
        """Return when the next message of a device came, or None."""
        end, found = time.perf_counter() + seconds, None
        while found is None and (left := end - time.perf_counter()) > 0:
            self.link.settimeout(left)
            try:
                self.waiting += self.link.recv(1 << 16)
            except TimeoutError:
                break
            now = time.perf_counter()
            while len(self.waiting) >= 58:
                size = struct.unpack(">Q", self.waiting[42:50])[0]
                if len(self.waiting) < 58 + size:
                    break
                name = self.waiting[14:34].rstrip(b"\0").decode()
                if name == "NeedlefitStatus":
                    self.status = json.loads(self.waiting[62 : 58 + size])
                found = now if name == device else found
                self.waiting = self.waiting[58 + size :]
        return found


def visit(port: int, number: int) -> None:
    """Connect as another client that goes at once; every other one sends garbage."""
    with socket.create_connection(("127.0.0.1", port)) as other:
        if number % 2:
            other.sendall(random.Random(number).randbytes(20_000))


def read_memory(pid: int) -> float:
    """Return the resident memory of a process, MB."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    main()
