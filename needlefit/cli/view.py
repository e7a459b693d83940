"""`needlefit view`: interactive simulation in the browser."""

import shlex
import signal
import threading
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from needlefit.cli import options, screen
from needlefit.cli.exit_codes import Invocation
from needlefit.cli.options import complete_view_targets, takes
from needlefit.cli.view_scan import names_scan, open_session
from needlefit.project.outputs import require_writable

if TYPE_CHECKING:
    from needlefit.project.locate import SpecimenChoice
    from needlefit.schemas.tracker import TrackerRecord
    from needlefit.viewer.openigtlink import OpenIGTLinkServer
    from needlefit.viewer.opening import ViewedScene
    from needlefit.viewer.server import AccessControl, ServedPage
    from needlefit.viewer.trials import TrialRegistry


@takes("out quiet verbose")
def view(
    context: typer.Context,
    target: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENE | RUN[/ID] | DATASET/ID | SCAN",
            autocompletion=complete_view_targets,
            show_default=False,
            help="What to steer: a scene, a run's fitted insertion with its predictive band, or a measured "
            "insertion. Or a scan to examine: a volume, TABLE.csv[/ID] with a table of scans, or the folder "
            "of one: DATASET.refused[/ID].",
        ),
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option(
            metavar="LOG", help="Replay this recording, and continue from its end; it replaces SCENE."
        ),
    ] = None,
    specimen: Annotated[
        Literal["new", "same"] | None,
        typer.Option(
            help="Predictive band of a run: for a new specimen, or for the specimens fitted (default: as the "
            "run predicted the insertion).",
            show_default=False,
        ),
    ] = None,
    markers: options.Markers = None,
    fiducials: options.Fiducials = None,
    layers: options.Layers = None,
    layers_in: options.LayersIn = None,
    mask: options.Mask = None,
    series: options.Series = None,
    medium: options.Medium = None,
    recipe: Annotated[
        str | None,
        typer.Option(
            metavar="RECIPE",
            autocompletion=options.complete_reconstructions,
            show_default=False,
            help="configs/reconstruction, or a path (default: recipe.toml of the folder, or default).",
        ),
    ] = None,
    port: Annotated[
        int, typer.Option(metavar="N", min=0, max=65535, help="Port on 127.0.0.1 (0: any free one).")
    ] = 0,
    openigtlink: Annotated[
        int | None,
        typer.Option(
            metavar="PORT", min=0, max=65535, help="Serve OpenIGTLink too (18944 is usual; 0: any free port)."
        ),
    ] = None,
    openigtlink_host: Annotated[
        str, typer.Option(metavar="HOST", help="Address on which OpenIGTLink is served.")
    ] = "127.0.0.1",
    tracker: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="OpenIGTLink only: registration and errors of the tracker (TOML)."),
    ] = None,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page, or only print its address.")
    ] = True,
) -> None:
    """Steer a needle by hand, or examine and correct a scan, in the browser.

    Only this machine can open the page. Each needle is recorded to a CSV in OUT/view/;
    `needlefit simulate --recording LOG` replays it. For a SCAN, the page shows what `needlefit reconstruct`
    finds, and saves your corrections to OUT/scans/ as a table of scans; --markers to --recipe are for scans
    alone, as there. Ctrl-C ends.
    """
    if recording is not None and target is not None:
        raise typer.BadParameter("the recording names its target: leave it out", param_hint="TARGET")
    out = context.find_root().obj.out
    named = options.name_scan_files(markers, fiducials, layers, layers_in, mask, series, medium)
    if recording is None and target is not None and names_scan(target):
        if openigtlink is not None or tracker is not None:
            raise typer.BadParameter("is for a needle, not for a scan", param_hint="--openigtlink, --tracker")
        _examine(target, named, recipe, out / "scans", port, browser)
        return
    if named or recipe is not None:
        hints = ", ".join(map(options.scan_option, named)) or "--recipe"
        raise typer.BadParameter("is for scans alone", param_hint=hints)
    record = _read_tracker(openigtlink, tracker)
    require_writable(out / "view")
    serve = _server()
    trials = _trials(context.find_root().obj, target, recording, out / "view", specimen or "shown")
    from needlefit.viewer.server import SteeringPage

    server = None if record is None else _openigtlink(record, trials, openigtlink_host, openigtlink or 0)
    _serve(serve, SteeringPage(trials, server), port, browser)
    for path in trials.written():
        screen.print_line(f"recorded: {path}")
        screen.print_note(f"replay it: {shlex.join(('needlefit', 'simulate', '--recording', str(path)))}")


def _examine(
    target: str, named: dict[str, Any], recipe: str | None, folder: Path, port: int, browser: bool
) -> None:
    """Serve the page of a scan."""
    require_writable(folder)
    serve = _server()
    screen.print_note(f"needlefit: examining {target}")
    session = open_session(target, named, recipe, folder)
    from needlefit.viewer.server import ScanPage

    _serve(serve, ScanPage(session), port, browser)
    path = session.keep_unsaved()
    if path is not None:
        screen.print_line(f"corrected: {path}")
        screen.print_note(f"reconstruct it: {session.command(path)}")


def _serve(
    serve: Callable[..., "Coroutine[None, None, None]"], page: "ServedPage", port: int, browser: bool
) -> None:
    """Serve a page until Ctrl-C."""
    import asyncio  # here, since every `--help` would wait for it
    import webbrowser

    def ready(access: "AccessControl") -> None:
        screen.print_line(access.address)
        if (server := getattr(page, "openigtlink", None)) is not None:
            screen.print_note("needlefit: OpenIGTLink at {}:{}; research use only".format(*server.address))
        screen.print_note("needlefit: Ctrl-C ends")
        if browser:  # some browsers hold up whoever calls them
            threading.Thread(target=webbrowser.open, args=(access.address,), daemon=True).start()

    asyncio.run(serve(page, port, ready, _until_stopped))


def _server() -> Callable[..., "Coroutine[None, None, None]"]:
    """Return what serves, if what that needs is installed."""
    try:
        from needlefit.viewer.server import serve
    except ModuleNotFoundError as error:
        if error.name != "aiohttp":
            raise
        from needlefit.errors import ConfigError

        raise ConfigError(
            "the page needs aiohttp, which is not installed",
            fix="pip install 'needlefit[view]'",
        ) from None
    return serve


def _read_tracker(port: int | None, path: Path | None) -> "TrackerRecord | None":
    """Return the tracker's file; None without OpenIGTLink."""
    if port is None:
        if path is not None:
            raise typer.BadParameter("it is used with --openigtlink alone", param_hint="--tracker")
        return None
    from needlefit.errors import ConfigError
    from needlefit.project.load import load
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
        if (error.name or "").partition(".")[0] != "pyigtl":
            raise
        from needlefit.errors import ConfigError

        raise ConfigError(
            "OpenIGTLink needs pyigtl, which is not installed",
            fix="pip install 'needlefit[view,openigtlink]'",
        ) from None
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
    from needlefit.viewer.opening import open_recording, open_target
    from needlefit.viewer.recording import read_recording
    from needlefit.viewer.trials import TrialRegistry

    source = None if recording is None else read_recording(recording)
    shown = open_target(target, specimen=specimen) if source is None else open_recording(source)
    screen.print_warnings(invocation, shown.warnings)

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
