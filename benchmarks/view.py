"""Whether the page of `needlefit view` is real time, in a headless browser that draws by software.

    python benchmarks/view.py [SUBJECT] [--times 100] [--json]

Writes the page of SUBJECT (default: the scene phantom2_fitted, which has posterior draws) and reports, ms:

first     from the navigation of an open browser to the first picture.
keys      from the time stamp of a key that inserts or retracts to when the browser has drawn the frame with
          its effect (a message posted in that frame and received after it); median and 95th percentile.
modulus   the same, of a key of the slider of mu: the whole insertion is simulated again.
phone_*   the same, in a window of PHONE, with a processor that is slowed down by PHONE_SLOWER.
band      from a key to the band of the needle that it leads to.

The browser is the one that is installed (`chromium`), the driver Playwright's.
"""

import argparse
import json
import os
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np
from playwright.sync_api import Page, sync_playwright

from needlefit.viewer.opening import open_target
from needlefit.viewer.page_needle import compose_page

PHONE_SLOWER, PHONE = 5, {"width": 390, "height": 844}
SIZE = {"width": 1280, "height": 800}
PAUSE_MS = 60
WATCH = """() => {
    window.waits = [];
    addEventListener("keydown", ({ timeStamp }) => requestAnimationFrame(() => {
        const channel = new MessageChannel();
        channel.port1.onmessage = () => window.waits.push(performance.now() - timeStamp);
        channel.port2.postMessage(null);
    }), true);
}"""
BAND_DONE = "needlefit.band?.step === needlefit.state.step"


def measure_first(page: Page, address: str) -> float:
    """Return the time to the first picture, ms."""
    page.goto("about:blank")
    began = time.monotonic()
    page.goto(address)
    page.wait_for_selector("#picture path", state="attached")
    return 1000 * (time.monotonic() - began)


def measure_keys(page: Page, place: str, keys: tuple[str, str], times: int) -> list[float]:
    """Return the median and the 95th percentile of the time from a key to its picture, ms."""
    page.focus(place)
    page.evaluate("window.waits.length = 0")
    for n in range(times):
        page.keyboard.press(keys[n % 2])
        page.wait_for_timeout(PAUSE_MS)
    waits = page.evaluate("window.waits")
    return [round(float(one), 1) for one in np.percentile(waits, (50, 95))]


def measure_bands(page: Page, times: int) -> float:
    """Return the median time from a key to the band of its needle, ms."""
    page.focus("#picture")
    waits = []
    for n in range(times):
        began = time.monotonic()
        page.keyboard.press("ArrowDown" if n % 2 else "ArrowUp")
        while not page.evaluate(BAND_DONE):
            time.sleep(0.002)
        waits.append(1000 * (time.monotonic() - began))
    return float(np.median(waits))


def measure(subject: str, times: int) -> dict[str, object]:
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        path = Path(folder) / "page.html"
        path.write_text(compose_page(open_target(subject)), "utf-8")
        flags = ["--no-sandbox", "--disable-gpu"]
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
        page = browser.new_page(viewport=SIZE, reduced_motion="reduce")
        found: dict[str, object] = {"characters": len(path.read_text("utf-8"))}
        found["first"] = round(min(measure_first(page, path.as_uri()) for _ in range(5)))
        page.wait_for_timeout(1000)
        page.evaluate(WATCH)
        arrows = ("ArrowLeft", "ArrowRight")
        slider = "#tissue-fields .slider >> nth=1"
        found["keys"] = measure_keys(page, "#picture", arrows, times)
        found["modulus"] = measure_keys(page, slider, arrows, times)
        if page.evaluate("needlefit.scene.draws !== null"):
            found["band"] = round(measure_bands(page, min(times, 20)))
        page.set_viewport_size(PHONE)
        devtools = page.context.new_cdp_session(page)
        devtools.send("Emulation.setCPUThrottlingRate", {"rate": PHONE_SLOWER})
        found["phone_keys"] = measure_keys(page, "#picture", arrows, times)
        found["phone_modulus"] = measure_keys(page, slider, arrows, times)
        browser.close()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("subject", nargs="?", default="phantom2_fitted")
    parser.add_argument("--times", type=int, default=100)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    found = {"cores": os.cpu_count(), "load": os.getloadavg()[0], **measure(asked.subject, asked.times)}
    if asked.json:
        print(json.dumps(found, indent=2))
        return
    for key, value in found.items():
        print(f"{key:16} {value}")


if __name__ == "__main__":
    main()
