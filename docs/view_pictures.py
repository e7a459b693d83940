"""Take the pictures of the page in docs/figures: start_view.png and view*.png.

    python docs/view_pictures.py

Opens pages in the installed Chromium (Playwright): of twin/phantom2-05 at a depth of 34 mm, and of the scene
phantom2_fitted at 15 mm, with a target, an obstacle and the plan, and with b and mu on their ridge.
start_view.png is of the run that the commands of start.md make.
"""

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import transcripts
from playwright.sync_api import Page, sync_playwright

FIGURES = Path(__file__).parent / "figures"
GOAL = "{ target: [46, -1], radius: 0.8, obstacles: [[30, -1.4, 0.4]] }"
SIZE = {"width": 1280, "height": 900}


def wait(page: Page, condition: str) -> None:
    """Wait until a function of the page's state holds."""
    while not page.evaluate(f"({condition})(window.needlefit?.state)"):
        page.wait_for_timeout(50)


def insert(page: Page, depth: float) -> None:
    """Insert to a depth, mm, and leave the fields as a new page has them."""
    page.fill("#speed", "1000")
    page.fill("#goto-depth", str(depth))
    page.press("#goto-depth", "Enter")
    wait(page, f"state => Math.abs(state.depth_mm - {depth}) < 1e-6 && !state.moving")
    page.fill("#speed", "10")


def save(page: Page, name: str, shown: str | None = None) -> None:
    """Save the picture, a part of the panel scrolled into view."""
    if shown:
        page.locator(shown).scroll_into_view_if_needed()
    page.evaluate("document.activeElement.blur()")
    page.mouse.move(0, 0)
    page.wait_for_timeout(1500)
    page.screenshot(path=FIGURES / name)


@contextmanager
def open_browser(address: str) -> Iterator[Callable[[], Page]]:
    """Yield what opens the page anew."""
    with sync_playwright() as play:
        browser = play.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )

        def open_page() -> Page:
            page = browser.new_context(viewport=SIZE, reduced_motion="reduce").new_page()
            page.goto(address)
            wait(page, "state => state && window.needlefit.connected")
            page.click("#everything")
            return page

        yield open_page
        browser.close()


def take(address: str) -> None:
    with open_browser(address) as open_page:
        page = open_page()
        insert(page, 34)
        save(page, "view.png")


def take_ridge(address: str) -> None:
    with open_browser(address) as open_page:
        page = open_page()
        page.click("#everything")
        page.locator("#scene-list button").last.click()
        page.locator(".ridge").wait_for()
        box = page.locator(".ridge").bounding_box()
        page.mouse.click(box["x"] + 0.45 * box["width"], box["y"] + 0.45 * box["height"])
        save(page, "view_ridge.png")


def take_plan(address: str) -> None:
    with open_browser(address) as open_page:
        page = open_page()
        insert(page, 15)
        page.evaluate(f"import('/page/aim.js').then(({{ setAim }}) => setAim({GOAL}))")
        page.locator("details:has(#make-plan) > summary").click()
        page.click("#make-plan")
        wait(page, "() => window.needlefit.aim.plan")
        save(page, "view_plan.png", "#plan-note")


def take_start(address: str) -> None:
    with open_browser(address) as open_page:
        page = open_page()
        insert(page, page.evaluate("window.needlefit.scene.measured.depth_mm"))
        wait(page, "state => window.needlefit.band?.step === state.step")
        save(page, "start_view.png")


def serve(target: str, then: Callable[[str], None], cwd: str | None = None) -> None:
    """Run the page of a target, from the folder `cwd`, while pictures of it are taken."""
    with tempfile.TemporaryDirectory() as folder:
        words = "-m", "needlefit", "view", target, "--no-browser", "--out", folder
        command = [sys.executable, *words]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=cwd) as process:
            try:
                then(process.stdout.readline().strip())
            finally:
                process.terminate()


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        page = FIGURES.parent / "start.md"
        transcripts.run_page(page.read_text(encoding="utf-8"), folder)
        serve("reports/mine_study/n8", then=take_start, cwd=folder)
    serve("twin/phantom2-05", then=take)
    serve("phantom2_fitted", then=take_plan)
    serve("phantom2_fitted", then=take_ridge)


if __name__ == "__main__":
    main()
