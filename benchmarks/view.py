"""Whether `needlefit view` is real time: its own page, in a headless browser that draws by software.

    python benchmarks/view.py [SUBJECT] [--seconds 60] [--json]

Serves SUBJECT (default: the measured insertion twin/phantom2-05, elements of 1 mm) and steers its page as a
hand would, by events that go through the browser: the insertion key is held, then the other one, while the
pointer drags the base up and down. For --seconds the page records every animation frame:

frames      late: further from the one before than 1.5 of 1/60 s, each counted as the frames that fell out;
            stale: shown while the needle moved, without a state of its own.
latency     from the time stamp of the input event to when the browser had drawn the first frame that shows
            its effect (a message posted in that frame and received after it); of the wheel apart, which
            the browser delays before the page receives it; of keys and of mu at a depth of 140 mm, there
            also on a window of PHONE, with a processor that is slowed down by PHONE_SLOWER.
            Half a FRAME of it, on average, is waiting for the next one; `own` is what comes after that.
band        from the frame that shows a needle to the one with its band, at 55 and 140 mm, of the scene DRAWN.
first       from the command to the first picture, in a browser that is open already.

The browser is the one that is installed (`chromium`), the driver Playwright's.
"""

import argparse
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from playwright.sync_api import Page, sync_playwright

FRAME = 1000 / 60
LATE = 1.5
DRAWN = "phantom2_fitted"
DEEP_MM = 140.0
"""Depth at which a modulus is changed: the whole insertion is simulated again."""
PHONE_SLOWER, PHONE = 5, {"width": 390, "height": 844}
SIZE = {"width": 1280, "height": 800}
FLAGS = ["--no-sandbox", "--disable-gpu"]


@contextmanager
def served(subject: str, out: Path) -> Iterator[str]:
    """Yield the address of a server in a process of its own."""
    command = [sys.executable, "-m", "needlefit", "view", subject, "--no-browser", "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield process.stdout.readline().strip()
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(20)


@contextmanager
def opened(address: str) -> Iterator[Page]:
    """Yield the page in a headless browser."""
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        page = browser.new_page(viewport=SIZE, reduced_motion="reduce")
        page.goto(address)
        while not page.evaluate("window.needlefit?.state"):
            page.wait_for_timeout(50)
        page.click("#everything")  # all inputs
        page.click("[data-fit=whole]")  # the base, too, is to be seen
        yield page
        browser.close()


def place(page: Page, what: str) -> tuple[float, float]:
    """Return where `base` or `tip` stands in the window, pixels."""
    return tuple(
        page.evaluate(
            """async (what) => {
                const { toPx, toPy } = await import("/page/view.js");
                const box = document.getElementById("canvas").getBoundingClientRect();
                const at = window.needlefit.state[what];
                return [box.left + toPx(at.x), box.top + toPy(at.y)];
            }""",
            what,
        )
    )


def drive(page: Page, seconds: float) -> None:
    """Insert and retract by the keys, and drag the base about its place meanwhile."""
    page.focus("#canvas")
    x, y = place(page, "base")
    page.mouse.move(x, y)
    page.mouse.down()
    began, held = time.monotonic(), None
    while (t := time.monotonic() - began) < seconds:
        wanted = "ArrowRight" if t % 8 < 4 else "ArrowLeft"
        if wanted != held:
            if held:
                page.keyboard.up(held)
            page.keyboard.down(wanted)
            held = wanted
        page.mouse.move(place(page, "base")[0], y + 25 * math.sin(2 * math.pi * t / 3))
        time.sleep(0.012)
    page.keyboard.up(held)
    page.mouse.up()


def turn(page: Page, seconds: float) -> None:
    """Insert and retract by the wheel."""
    page.hover("#canvas", position={"x": 300, "y": 60})
    began = time.monotonic()
    while (t := time.monotonic() - began) < seconds:
        page.mouse.wheel(0, 100 if t % 2 < 1 else -100)
        time.sleep(0.05)


def nudge(page: Page, seconds: float) -> None:
    """Move the base by keys."""
    page.focus("#canvas")
    began = time.monotonic()
    while (t := time.monotonic() - began) < seconds:
        page.keyboard.press("ArrowUp" if t % 2 < 1 else "ArrowDown")
        time.sleep(0.05)


def reach(page: Page, depth: float) -> None:
    """Insert to a depth, mm, with a b that keeps the needle within the model's validity."""
    page.fill("#bevel-fields .number", "0.02")
    page.press("#bevel-fields .number", "Enter")
    page.click("#throughout")
    page.fill("#speed", "1000")
    page.fill("#goto-depth", str(depth))
    page.press("#goto-depth", "Enter")
    while abs(page.evaluate("window.needlefit.state.depth_mm") - depth) > 1e-6:
        page.wait_for_timeout(50)


def band_waits(page: Page, times: int = 20) -> dict[str, float]:
    """Return percentiles of the time from the picture of a needle to its band, ms."""
    page.focus("#canvas")
    start = page.evaluate("performance.now()")
    for n in range(times):
        page.keyboard.press("ArrowDown" if n % 2 else "ArrowUp")  # it ends where it began
        page.wait_for_timeout(400)
    needles, bands = {}, {}
    for frame in sorted(page.evaluate("window.needlefit.frames"), key=lambda frame: frame["t"]):
        if frame["t"] > start and frame["painted"] is not None:
            needles.setdefault(frame["step"], frame["painted"])
            bands.setdefault(frame["band"], frame["painted"])
    found = [bands[step] - shown for step, shown in needles.items() if step in bands]
    return {f"p{p}": round(float(np.percentile(found, p)), 1) for p in (0, 50, 95)} | {"bands": len(found)}


def first_picture(subject: str) -> float:
    """Return the time from the command to the first picture, s."""
    with tempfile.TemporaryDirectory() as out, sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        page = browser.new_page(viewport=SIZE, reduced_motion="reduce")
        page.goto("about:blank")
        began = time.monotonic()
        with served(subject, Path(out)) as address:
            page.goto(address)
            page.wait_for_selector("body.begun", state="attached")
            spent = time.monotonic() - began
            browser.close()
    return spent


def slide(page: Page, seconds: float) -> None:
    """Change mu of the first layer by its slider, again and again."""
    page.locator("#tissue-fields .slider").first.focus()
    began = time.monotonic()
    while (t := time.monotonic() - began) < seconds:
        page.keyboard.press("ArrowRight" if t % 2 < 1 else "ArrowLeft")
        time.sleep(0.15)


def measure_frames(page: Page, steer: Callable[[Page, float], None], seconds: float) -> list[dict]:
    """Return the frame times of the page while it was steered, in order."""
    start = page.evaluate("performance.now()")
    steer(page, seconds)
    frames = sorted(page.evaluate("window.needlefit.frames"), key=lambda frame: frame["t"])
    return [frame for frame in frames if start <= frame["t"] <= start + 1000 * seconds]


def waits(frames: list[dict]) -> dict[str, float]:
    """Return percentiles of the time from an input to its picture, ms, and how many inputs there were."""
    latency = np.array([frame["latency_ms"] for frame in frames if frame["latency_ms"] is not None])
    found = {f"p{p}": round(float(np.percentile(latency, p)), 1) for p in (50, 95, 99)}
    own = [frame["painted"] - frame["t"] for frame in frames if frame["latency_ms"] is not None]
    return found | {"own_p95": round(float(np.percentile(own, 95)), 1), "inputs": len(latency)}


def real_time(subject: str, seconds: float) -> dict:
    """Return how many frames were missed, and how long a user waits."""
    with (
        tempfile.TemporaryDirectory() as out,
        served(subject, Path(out)) as address,
        opened(address) as page,
    ):
        drive(page, 3.0)  # everything is loaded
        frames = measure_frames(page, drive, seconds)
        wheel = measure_frames(page, turn, seconds / 4)
        reach(page, DEEP_MM)
        deep = {
            f"{name}_latency_ms": waits(measure_frames(page, steer, seconds / 4))
            for name, steer in (("deep_keys", nudge), ("deep_wheel", turn), ("modulus", slide))
        }
        page.set_viewport_size(PHONE)
        devtools = page.context.new_cdp_session(page)
        devtools.send("Emulation.setCPUThrottlingRate", {"rate": PHONE_SLOWER})
        for name, steer in (("phone_keys", nudge), ("phone_modulus", slide)):
            deep[f"{name}_latency_ms"] = waits(measure_frames(page, steer, seconds / 4))
    bands = {}
    with tempfile.TemporaryDirectory() as out, served(DRAWN, Path(out)) as address, opened(address) as page:
        for depth in (55.0, DEEP_MM):
            reach(page, depth)
            bands[f"band_ms_{depth:.0f}"] = band_waits(page)
    t = np.array([frame["t"] for frame in frames])
    fell_out = np.maximum(np.rint(np.diff(t) / FRAME) - 1, 0)[np.diff(t) > LATE * FRAME].sum()
    return {
        "frames": len(frames),
        "late_percent": 100 * float(fell_out) * FRAME / (t[-1] - t[0]),
        "stale_percent": 100 * sum(not frame["fresh"] for frame in frames) / len(frames),
        "longest_ms": float(np.diff(t).max()),
        "latency_ms": waits(frames),
        "wheel_latency_ms": waits(wheel),
        **deep,
        **bands,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("subject", nargs="?", default="twin/phantom2-05")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    found = {"cores": os.cpu_count(), "load": os.getloadavg()[0]}
    found["first_picture_s"] = round(min(first_picture(asked.subject) for _ in range(3)), 2)
    found |= real_time(asked.subject, asked.seconds)
    if asked.json:
        print(json.dumps(found, indent=2))
        return
    for key, value in found.items():
        print(f"{key:24} {value}")


if __name__ == "__main__":
    main()
