"""`needlefit view`: interactive simulation in the browser."""

import shlex
import signal
import threading
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from needlefit.cli import screen
from needlefit.cli.exit_codes import Invocation
from needlefit.cli.options import (
    REPORTS,
    Out,
    Plugins,
    Quiet,
    argument,
    option,
)
from needlefit.errors import ConfigError
from needlefit.project.folders import require_writable
from needlefit.project.locate import find_view_target

if TYPE_CHECKING:
    from needlefit.project.locate import SpecimenChoice
    from needlefit.viewer.server import AccessControl
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
    recording: Annotated[
        Path | None, option("Open this recording at its end, and continue; it replaces SCENE.", "LOG")
    ] = None,
    specimen: Annotated[
        Literal["new", "same"] | None,
        option(
            "Predictive band of a run: for a new specimen, or for the specimens fitted (default: as the run "
            "predicted the insertion)."
        ),
    ] = None,
    port: Annotated[int, option("Port on 127.0.0.1 (0: any free one).", "N", min=0, max=65535)] = 0,
    browser: Annotated[
        bool, option("Open the page, or only print its address.", None, "--browser/--no-browser")
    ] = True,
    out: Out = REPORTS,
    quiet: Quiet = False,
    plugins: Plugins = None,
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
    serve = _server()
    from needlefit.viewer.steering_page import SteeringPage

    trials = _trials(context.find_root().obj, target, recording, out / "view", specimen or "shown")
    _serve(serve, SteeringPage(trials), port, browser)
    for path in trials.written():
        screen.print_line(f"recorded: {path}")
        screen.print_note(f"replay it: {shlex.join(('needlefit', 'simulate', '--recording', str(path)))}")


def _serve(
    serve: Callable[..., "Coroutine[None, None, None]"],
    page: "SteeringPage",
    port: int,
    browser: bool,
) -> None:
    import asyncio  # here, since every `--help` would wait for it
    import webbrowser

    def ready(access: "AccessControl") -> None:
        screen.print_line(access.address)
        screen.print_note("needlefit: Ctrl-C ends")
        if browser:  # some browsers hold up whoever calls them
            threading.Thread(target=webbrowser.open, args=(access.address,), daemon=True).start()

    asyncio.run(serve(page, port, ready, _until_stopped))


def _server() -> Callable[..., "Coroutine[None, None, None]"]:
    try:
        from needlefit.viewer.server import serve
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "aiohttp":
            raise
        what = "the page needs aiohttp, which is not installed"
        raise ConfigError(what, fix="pip install 'needlefit[view]'") from None
    return serve


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


async def _until_stopped() -> None:
    """Wait for Ctrl-C or a signal to end."""
    import asyncio

    stopped, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stopped.set)
    await stopped.wait()
