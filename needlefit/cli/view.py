"""`needlefit view`: interactive simulation in the browser."""

import shlex
import signal
import threading
from collections.abc import Callable, Coroutine
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from needlefit.cli import options, screen
from needlefit.cli.exit_codes import Invocation
from needlefit.cli.options import complete_view_targets, option, takes
from needlefit.errors import ConfigError
from needlefit.project.folders import require_writable
from needlefit.project.locate import find_view_target

if TYPE_CHECKING:
    from needlefit.project.locate import SpecimenChoice
    from needlefit.schemas.tracker import TrackerRecord
    from needlefit.viewer.openigtlink import OpenIGTLinkServer
    from needlefit.viewer.server import AccessControl, LoadingPage
    from needlefit.viewer.steering_page import SteeringPage
    from needlefit.viewer.trials import TrialRegistry


@takes(
    "out quiet verbose",
    target=options.argument(
        "SCENE | RUN[/ID] | DATASET/ID",
        "What to steer: a scene, a run's fitted insertion with its predictive band, or a measured insertion.",
        complete_view_targets,
        show_default=False,
    ),
    recording=option("Replay this recording, and continue from its end; it replaces SCENE.", "LOG"),
    specimen=option(
        "Predictive band of a run: for a new specimen, or for the specimens fitted (default: as the run "
        "predicted the insertion).",
        show_default=False,
    ),
    port=option("Port on 127.0.0.1 (0: any free one).", "N", min=0, max=65535),
    openigtlink=option("Serve OpenIGTLink too (18944 is usual; 0: any free port).", "PORT", min=0, max=65535),
    openigtlink_host=option("Address on which OpenIGTLink is served.", "HOST"),
    tracker=option("OpenIGTLink only: registration and errors of the tracker (TOML).", "FILE"),
    browser=options.flag("Open the page, or only print its address.", "--browser/--no-browser"),
)
def view(
    context: typer.Context,
    target: str | None = None,
    recording: Path | None = None,
    specimen: Literal["new", "same"] | None = None,
    port: int = 0,
    openigtlink: int | None = None,
    openigtlink_host: str = "127.0.0.1",
    tracker: Path | None = None,
    browser: bool = True,
) -> None:
    """Steer a needle by hand in the browser.

    Only this machine can open the page. Each needle is recorded to a CSV in OUT/view/;
    `needlefit simulate --recording LOG` replays it. Ctrl-C ends.
    """
    if recording is not None and target is not None:
        raise typer.BadParameter("the recording names its target: leave it out", param_hint="TARGET")
    out = context.find_root().obj.out
    record = _read_tracker(openigtlink, tracker)
    require_writable(out / "view")
    if target is not None:
        find_view_target(target)  # a wrong name ends it before a page opens
    serve = _server()
    begun: list[TrialRegistry] = []

    def load(show: Callable[[str], None]) -> "SteeringPage":
        show("Loading the model")
        from needlefit.viewer.steering_page import SteeringPage

        show(f"Reading {recording or target or 'the scene'}")
        trials = _trials(context.find_root().obj, target, recording, out / "view", specimen or "shown")
        begun.append(trials)
        if record is None:
            return SteeringPage(trials)
        return SteeringPage(trials, _openigtlink(record, trials, openigtlink_host, openigtlink or 0))

    from needlefit.viewer.server import LoadingPage

    _serve(serve, LoadingPage(load), port, browser)
    for path in begun[0].written() if begun else ():
        screen.print_line(f"recorded: {path}")
        screen.print_note(f"replay it: {shlex.join(('needlefit', 'simulate', '--recording', str(path)))}")


def _serve(
    serve: Callable[..., "Coroutine[None, None, None]"],
    page: "LoadingPage",
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

    asyncio.run(serve(page, port, ready, partial(_until_stopped, page)))


def _server() -> Callable[..., "Coroutine[None, None, None]"]:
    try:
        from needlefit.viewer.server import serve
    except ModuleNotFoundError as error:
        raise _explain_missing(error, "aiohttp", "the page", "view") from None
    return serve


def _explain_missing(error: ModuleNotFoundError, package: str, user: str, extra: str) -> Exception:
    """Return the error of a package that is not installed; any other stays as it is."""
    if (error.name or "").partition(".")[0] != package:
        return error
    what = f"{user} needs {package}, which is not installed"
    return ConfigError(what, fix=f"pip install 'needlefit[{extra}]'")


def _read_tracker(port: int | None, path: Path | None) -> "TrackerRecord | None":
    """Return the tracker's file; None without OpenIGTLink."""
    if port is None:
        if path is not None:
            raise typer.BadParameter("it is used with --openigtlink alone", param_hint="--tracker")
        return None
    from needlefit.project.toml import load
    from needlefit.schemas.tracker import TrackerRecord

    if path is None:
        raise ConfigError(
            "the tracker is not registered",
            where="--openigtlink",
            expected="--tracker FILE with tracker_to_ras, or with markers",
            fix="where transforms are in RAS already, give the identity as tracker_to_ras",
        )
    return load(path, TrackerRecord)


def _openigtlink(
    record: "TrackerRecord", trials: "TrialRegistry", host: str, port: int
) -> "OpenIGTLinkServer":
    from needlefit.viewer.tracking import TrackedTrial

    try:
        from needlefit.viewer.openigtlink import OpenIGTLinkServer
    except ModuleNotFoundError as error:
        raise _explain_missing(error, "pyigtl", "OpenIGTLink", "view,openigtlink") from None
    tracked = TrackedTrial(record, trials)
    if tracked.registration_error is not None:
        screen.print_note(
            f"needlefit: markers registered within {tracked.registration_error:.2f} mm (root mean square)"
        )
    if host not in ("127.0.0.1", "localhost", "::1"):
        screen.print_note(f"needlefit: whoever reaches {host} can move the needle of the page: no password")
    return OpenIGTLinkServer(tracked, host, port)


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


async def _until_stopped(page: "LoadingPage") -> None:
    """Wait for Ctrl-C or a signal to end; raise the error of a page that could not be loaded."""
    import asyncio

    stopped, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stopped.set)
    waiting = asyncio.create_task(stopped.wait())
    loading = asyncio.create_task(page.ended.wait())
    await asyncio.wait((waiting, loading), return_when=asyncio.FIRST_COMPLETED)
    if page.error is not None:
        raise page.error
    if page.loaded is not None and (server := page.loaded.openigtlink) is not None:
        screen.print_note("needlefit: OpenIGTLink at {}:{}; research use only".format(*server.address))
    await waiting
