"""`needlefit view`: interactive simulation in the browser."""

import shlex
import signal
import threading
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.exit_codes import STOP_SIGNALS
from needlefit.cli.options import argument, option
from needlefit.project.folders import require_writable

if TYPE_CHECKING:
    from needlefit.viewer.server import AccessControl
    from needlefit.viewer.steering_page import SteeringPage


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
    out: options.Out = None,
    quiet: options.Quiet = False,
    plugins: options.Plugins = None,
) -> None:
    """Steer a needle by hand in the browser.

    Only this machine can open the page. Each needle is recorded to a CSV in OUT/view/ (default: ./reports);
    `needlefit simulate --recording LOG` replays it. Ctrl-C ends.
    """
    if recording is not None and target is not None:
        raise typer.BadParameter("the recording names its target: leave it out", param_hint="TARGET")
    folder = context.find_root().obj.out / "view"
    require_writable(folder)
    if target is not None:
        options.note_others("view", target)  # a wrong name ends it before a page opens
    from needlefit.planning.recording import read_recording
    from needlefit.viewer.opening import open_recording, open_target
    from needlefit.viewer.steering_page import SteeringPage
    from needlefit.viewer.trials import TrialRegistry

    source, into = None if recording is None else read_recording(recording), specimen or "shown"
    shown = open_target(target, specimen=into) if source is None else open_recording(source)
    screen.print_warnings(context.find_root().obj, shown.warnings)
    trials = TrialRegistry(shown, folder, lambda choice: open_target(shown.name, choice, into), source)
    _serve(SteeringPage(trials), port, browser)
    for path in trials.written():
        screen.print_line(f"recorded: {path}")
        screen.print_note(f"replay it: {shlex.join(('needlefit', 'simulate', '--recording', str(path)))}")


def _serve(page: "SteeringPage", port: int, browser: bool) -> None:
    import asyncio  # here, since every `--help` would wait for it
    import webbrowser

    from needlefit.viewer.server import serve

    def ready(access: "AccessControl") -> None:
        screen.print_line(access.address)
        screen.print_note("needlefit: Ctrl-C ends")
        if browser:  # some browsers hold up whoever calls them
            threading.Thread(target=webbrowser.open, args=(access.address,), daemon=True).start()

    async def stop() -> None:
        """Wait for Ctrl-C, SIGTERM or SIGHUP."""
        ended, loop = asyncio.Event(), asyncio.get_running_loop()
        # not `add_signal_handler`, which Windows has not
        before = {
            number: signal.signal(number, lambda *_: loop.call_soon_threadsafe(ended.set))
            for number in STOP_SIGNALS
        }
        try:
            await ended.wait()
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    with suppress(KeyboardInterrupt):
        asyncio.run(serve(page, port, ready, stop))
