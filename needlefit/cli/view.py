"""`needlefit view`: interactive simulation in the browser."""

import shlex
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.exit_codes import Invocation
from needlefit.cli.options import REPORTS, argument, option
from needlefit.project.folders import require_writable
from needlefit.project.locate import find_view_target

if TYPE_CHECKING:
    from needlefit.project.locate import SpecimenChoice
    from needlefit.viewer.server import AccessControl, LoadingPage
    from needlefit.viewer.steering_page import SteeringPage
    from needlefit.viewer.trials import TrialRegistry


def view(
    context: typer.Context,
    target: Annotated[
        str | None,
        argument(
            "SCENE | RUN[/ID] | DATASET/ID",
            "What to steer: a scene, a run's fitted insertion with its predictive band, or a measured "
            "insertion.",
        ),
    ] = None,
    recording: options.Recording = None,
    specimen: options.Specimen = None,
    port: Annotated[int, option("Port on 127.0.0.1 (0: any free one).", "N", min=0, max=65535)] = 0,
    browser: Annotated[
        bool, option("Open the page, or only print its address.", None, "--browser/--no-browser")
    ] = True,
    out: options.Out = REPORTS,
    quiet: options.Quiet = False,
    plugins: options.Plugins = None,
) -> None:
    """Steer a needle by hand in the browser.

    Only this machine can open the page. Each needle is recorded to a CSV in OUT/view/;
    `needlefit simulate --recording LOG` replays it. Ctrl-C ends.
    """
    if recording is not None and target is not None:
        raise typer.BadParameter("the recording names its target: leave it out", param_hint="TARGET")
    require_writable(out / "view")
    if target is not None:
        find_view_target(target)  # a wrong name ends it before a page opens
    from needlefit.viewer.server import LoadingPage

    begun: list[TrialRegistry] = []

    def load(show: Callable[[str], None]) -> "SteeringPage":
        show("Loading the model")
        from needlefit.viewer.steering_page import SteeringPage

        show(f"Reading {recording or target or 'the scene'}")
        trials = _trials(context.find_root().obj, target, recording, out / "view", specimen or "shown")
        begun.append(trials)
        return SteeringPage(trials)

    _serve(LoadingPage(load), port, browser)
    for path in begun[0].written() if begun else ():
        screen.print_line(f"recorded: {path}")
        screen.print_note(f"replay it: {shlex.join(('needlefit', 'simulate', '--recording', str(path)))}")


def _serve(page: "LoadingPage", port: int, browser: bool) -> None:
    import asyncio  # here, since every `--help` would wait for it
    import webbrowser

    from needlefit.viewer.server import serve

    def ready(access: "AccessControl") -> None:
        screen.print_line(access.address)
        screen.print_note("needlefit: Ctrl-C ends")
        if browser:  # some browsers hold up whoever calls them
            threading.Thread(target=webbrowser.open, args=(access.address,), daemon=True).start()

    with suppress(KeyboardInterrupt):
        asyncio.run(serve(page, port, ready, partial(_until_failed, page)))


def _trials(
    invocation: Invocation,
    target: str | None,
    recording: Path | None,
    folder: Path,
    specimen: "SpecimenChoice",
) -> "TrialRegistry":
    from needlefit.viewer.opening import open_recording, open_target, reopen
    from needlefit.viewer.recording import read_recording
    from needlefit.viewer.trials import TrialRegistry

    source = None if recording is None else read_recording(recording)
    shown = open_target(target, specimen=specimen) if source is None else open_recording(source)
    screen.print_warnings(invocation, shown.warnings)

    return TrialRegistry(shown, folder, lambda choice: reopen(shown, choice, specimen), source)


async def _until_failed(page: "LoadingPage") -> None:
    """Wait until Ctrl-C ends the program; raise the error of a page that could not be loaded."""
    import asyncio

    await page.ended.wait()
    if page.error is not None:
        raise page.error
    await asyncio.Event().wait()
