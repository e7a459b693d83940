"""`needlefit view`: a page on which a needle is steered by hand."""

import re
from pathlib import Path, PurePath
from typing import Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.options import argument, option
from needlefit.project.folders import require_writable


def view(
    context: typer.Context,
    target: Annotated[
        str | None,
        argument(
            "SCENE | RUN[/ID] | DATASET/ID",
            "What to steer: a scene, a run's fitted insertion, or a measured one.",
        ),
    ] = None,
    recording: options.Recording = None,
    specimen: options.Specimen = None,
    browser: Annotated[
        bool, option("Open the page, or only print its path.", None, "--browser/--no-browser")
    ] = True,
) -> None:
    """Write a page on which a needle is steered by hand, and open it.

    The page is one HTML file, OUT/view/NAME.html (default: ./reports): it computes the needle in any browser,
    offline. It saves the inputs as a recording, which `needlefit simulate --recording FILE` replays.
    """
    if recording is not None and target is not None:
        raise typer.BadParameter("the recording names its target: leave it out", param_hint="TARGET")
    folder = context.find_root().obj.out / "view"
    require_writable(folder)
    if target is not None:
        options.note_others("view", target)  # before a wrong name is reported
    from needlefit.planning.recording import read_recording
    from needlefit.viewer.opening import open_recording, open_target
    from needlefit.viewer.page_needle import compose_page

    source = None if recording is None else read_recording(recording)
    shown = open_target(target, specimen=specimen or "shown") if source is None else open_recording(source)
    screen.print_warnings(context.find_root().obj, shown.warnings)
    name = shown.name if recording is None else str(recording.with_suffix(""))
    path = write_page(folder, name, compose_page(shown, source))
    screen.print_line(str(path))
    if browser:
        import webbrowser

        webbrowser.open(path.resolve().as_uri())


def write_page(folder: Path, name: str, page: str) -> Path:
    """Write a page to a folder, in a file named by the last two parts of what it shows; return its path."""
    last = "-".join(PurePath(name.removesuffix(".toml")).parts[-2:])
    stem = re.sub(r"[^\w-]+", "-", last).strip("-")
    path = folder / f"{stem or 'needle'}.html"
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(page, "utf-8")
    return path
