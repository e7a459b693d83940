"""Take the pictures of the page in docs/figures: start_view.png and view*.png.

    python docs/view_pictures.py [NAME ...]

Opens pages in the installed Chromium (Playwright): of twin/phantom2-05, and of a plan.
start_view.png is of the run that the commands of start.md make.
"""

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import transcripts
from playwright.sync_api import Page, sync_playwright

FIGURES = Path(__file__).parent / "figures"
PLAN = ("plan", "phantom2_fitted", "--target", "46,-1", "--radius", "0.8", "--obstacle", "30,-1.4,0.4")
SIZE = {"width": 1280, "height": 900}


def needlefit(*words: str, cwd: Path | None = None) -> None:
    subprocess.run([sys.executable, "-m", "needlefit", *words], check=True, cwd=cwd)


@contextmanager
def opened(path: Path) -> Iterator[Page]:
    """Yield a page that has computed all it holds."""
    with sync_playwright() as play:
        flags = ["--no-sandbox", "--disable-gpu"]
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
        page = browser.new_context(viewport=SIZE, reduced_motion="reduce").new_page()
        page.goto(path.as_uri())
        while not page.evaluate("document.getElementById('proof').dataset.count"):
            page.wait_for_timeout(50)
        yield page
        browser.close()


def save(page: Page, name: str) -> None:
    page.evaluate("document.activeElement.blur()")
    page.mouse.move(0, 0)
    page.wait_for_timeout(1500)
    page.screenshot(path=FIGURES / f"{name}.png")


def take_view(folder: Path) -> None:
    needlefit("view", "twin/phantom2-05", "--no-browser", "--out", str(folder))
    with opened(folder / "view" / "twin-phantom2-05.html") as page:
        save(page, "view")


def take_plan(folder: Path) -> None:
    needlefit(*PLAN, "--out", str(folder))
    with opened(folder / "plan" / "phantom2_fitted.html") as page:
        save(page, "view_plan")


def take_start(folder: Path) -> None:
    page = FIGURES.parent / "start.md"
    transcripts.run_page(page.read_text(encoding="utf-8"), str(folder))
    needlefit("view", "reports/mine_study/n8", "--no-browser", cwd=folder)
    with opened(folder / "reports" / "view" / "mine_study-n8.html") as page:
        save(page, "start_view")


PICTURES = {"start_view": take_start, "view": take_view, "view_plan": take_plan}

if __name__ == "__main__":
    for name in sys.argv[1:] or PICTURES:
        with tempfile.TemporaryDirectory() as place:
            PICTURES[name](Path(place))
