"""`needlefit view`: interactive simulation in the browser."""

import shlex
import signal
import threading
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from needlefit.cli import options, screen
from needlefit.cli.exit_codes import Invocation
from needlefit.cli.options import complete_view_targets
from needlefit.cli.screen import print_warnings
from needlefit.project.outputs import require_writable

if TYPE_CHECKING:
    from needlefit.viewer.serving.connections import AccessControl
    from needlefit.viewer.serving.trials import TrialRegistry
    from needlefit.viewer.viewed_scene import ViewedScene


def view(
    context: typer.Context,
    target: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENE | RUN[/ID] | DATASET/ID",
            autocompletion=complete_view_targets,
            show_default=False,
            help="What to steer: a scene, a run's fitted insertion with its predictive band, or a measured "
            "insertion.",
        ),
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option(
            metavar="LOG", help="Replay this recording, and continue from its end; it replaces SCENE."
        ),
    ] = None,
    specimen: Annotated[
        Literal["new", "same"],
        typer.Option(help="Predictive band of a run: for a new specimen, or for the specimens fitted."),
    ] = "new",
    port: Annotated[
        int, typer.Option(metavar="N", min=0, max=65535, help="Port on 127.0.0.1 (0: any free one).")
    ] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page, or only print its address.")
    ] = True,
    out: options.Out = Path("reports"),
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Steer a needle by hand, in real time, in the browser.

    Only this machine can open the page. Each needle is recorded to a CSV in OUT/view/;
    `needlefit simulate --recording LOG` replays it. Ctrl-C ends.
    """
    if recording is not None and target is not None:
        raise typer.BadParameter("the recording names its target: leave it out", param_hint="TARGET")
    import asyncio  # here, since every `--help` would wait for it
    import webbrowser

    require_writable(out / "view")
    serve = _server()
    screen.compile_ahead("lanes", quiet=quiet)
    trials = _trials(context.find_root().obj, target, recording, out / "view", specimen)

    def ready(access: "AccessControl") -> None:
        screen.print_line(access.address)
        screen.print_note("needlefit: Ctrl-C ends")
        if browser:  # some browsers hold up whoever calls them
            threading.Thread(target=webbrowser.open, args=(access.address,), daemon=True).start()

    asyncio.run(serve(trials, port, ready, _until_stopped))
    for path in trials.written():
        screen.print_line(f"recorded: {path}")
        screen.print_note(f"replay it: {shlex.join(('needlefit', 'simulate', '--recording', str(path)))}")


def _server() -> Callable[..., "Coroutine[None, None, None]"]:
    """Return what serves, if what that needs is installed."""
    try:
        from needlefit.viewer.serving.server import serve
    except ModuleNotFoundError as error:
        if error.name != "aiohttp":
            raise
        from needlefit.errors import ConfigError

        raise ConfigError(
            "the interactive simulation needs aiohttp, which is not installed",
            fix="pip install 'needlefit[view]'",
        ) from None
    return serve


def _trials(
    invocation: Invocation,
    target: str | None,
    recording: Path | None,
    folder: Path,
    specimen: Literal["new", "same"],
) -> "TrialRegistry":
    from needlefit.viewer.opening import open_recording, open_target
    from needlefit.viewer.recording import read_recording
    from needlefit.viewer.serving.trials import TrialRegistry

    source = None if recording is None else read_recording(recording)
    shown = open_target(target, specimen=specimen) if source is None else open_recording(source)
    print_warnings(invocation, shown.warnings)

    def reopen(insertion: str) -> "ViewedScene":
        return open_target(shown.name, insertion, specimen)

    return TrialRegistry(shown, folder, reopen, source)


async def _until_stopped() -> None:
    """Wait for Ctrl-C or a signal to end."""
    import asyncio

    stopped, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stopped.set)
    await stopped.wait()
