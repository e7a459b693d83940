"""`needlefit view`: interactive simulation in the browser."""

import shlex
import signal
import threading
from collections.abc import Callable, Coroutine, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from needlefit.cli import options, screen
from needlefit.cli.exit_codes import Invocation
from needlefit.cli.options import complete_view_targets, option, takes
from needlefit.errors import ConfigError
from needlefit.project.folders import require_writable
from needlefit.project.input_files import is_dir, is_file, path_exists
from needlefit.project.locate import find_file, find_view_target, list_names

if TYPE_CHECKING:
    from needlefit.imaging.scans import Scan
    from needlefit.project.locate import SpecimenChoice
    from needlefit.viewer.scan_page import ScanPage
    from needlefit.viewer.scan_session import ScanSession
    from needlefit.viewer.server import AccessControl, LoadingPage
    from needlefit.viewer.steering_page import SteeringPage
    from needlefit.viewer.trials import TrialRegistry


@takes(
    "out quiet verbose",
    target=options.argument(
        "SCENE | RUN[/ID] | DATASET/ID | SCAN",
        "What to steer: a scene, a run's fitted insertion with its predictive band, or a measured insertion. "
        "Or a scan to examine: a volume, TABLE.csv[/ID] with a table of scans, or the folder of one: "
        "DATASET.refused[/ID].",
        complete_view_targets,
        show_default=False,
    ),
    recording=option("Replay this recording, and continue from its end; it replaces SCENE.", "LOG"),
    specimen=option(
        "Predictive band of a run: for a new specimen, or for the specimens fitted (default: as the run "
        "predicted the insertion).",
        show_default=False,
    ),
    **options.SCAN_FILES,
    recipe=option(
        "configs/reconstruction, or a path (default: recipe.toml of the folder, or default).",
        "RECIPE",
        autocompletion=options.complete_reconstructions,
        show_default=False,
    ),
    port=option("Port on 127.0.0.1 (0: any free one).", "N", min=0, max=65535),
    browser=options.flag("Open the page, or only print its address.", "--browser/--no-browser"),
)
def view(
    context: typer.Context,
    target: str | None = None,
    recording: Path | None = None,
    specimen: Literal["new", "same"] | None = None,
    recipe: str | None = None,
    port: int = 0,
    browser: bool = True,
    **files: Any,  # noqa: ANN401 - those of `SCAN_FILES`
) -> None:
    """Steer a needle by hand, or correct a scan, in the browser.

    Only this machine can open the page. Each needle is recorded to a CSV in OUT/view/;
    `needlefit simulate --recording LOG` replays it. For a SCAN, the page shows what `needlefit reconstruct`
    finds, and saves your corrections to OUT/scans/ as a table of scans; --markers to --recipe are for scans
    alone, as there. Ctrl-C ends.
    """
    if recording is not None and target is not None:
        raise typer.BadParameter("the recording names its target: leave it out", param_hint="TARGET")
    out = context.find_root().obj.out
    named = options.name_scan_files(files)
    if recording is None and target is not None and names_scan(target):
        _examine(target, named, recipe, out / "scans", port, browser)
        return
    if named or recipe is not None:
        hints = ", ".join(map(options.scan_option, named)) or "--recipe"
        raise typer.BadParameter("is for scans alone", param_hint=hints)
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
        return SteeringPage(trials)

    from needlefit.viewer.server import LoadingPage

    _serve(serve, LoadingPage(load), port, browser)
    for path in begun[0].written() if begun else ():
        screen.print_line(f"recorded: {path}")
        screen.print_note(f"replay it: {shlex.join(('needlefit', 'simulate', '--recording', str(path)))}")


def _examine(
    target: str, named: dict[str, Any], recipe: str | None, folder: Path, port: int, browser: bool
) -> None:
    require_writable(folder)
    serve = _server()
    screen.print_note(f"needlefit: examining {target}")
    session = open_session(target, named, recipe, folder)
    from needlefit.viewer.scan_page import ScanPage

    _serve(serve, ScanPage(session), port, browser)
    path = session.keep_unsaved()
    if path is not None:
        screen.print_line(f"corrected: {path}")
        screen.print_note(f"reconstruct it: {session.command(path)}")
        if session.found.error is not None:
            screen.print_note(f"it is still refused: {session.found.error.what}")


def _serve(
    serve: Callable[..., "Coroutine[None, None, None]"],
    page: "LoadingPage | ScanPage",
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


async def _until_stopped(page: "LoadingPage | ScanPage") -> None:
    """Wait for Ctrl-C or a signal to end; raise the error of a page that could not be loaded."""
    import asyncio

    from needlefit.viewer.server import LoadingPage

    stopped, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stopped.set)
    waiting = asyncio.create_task(stopped.wait())
    if isinstance(page, LoadingPage):
        loading = asyncio.create_task(page.ended.wait())
        await asyncio.wait((waiting, loading), return_when=asyncio.FIRST_COMPLETED)
        if page.error is not None:
            raise page.error
    await waiting


# ---- scans


def names_scan(target: str | None) -> bool:
    """Whether a target is a volume, or a table of scans, or its folder, with or without `/ID`."""
    if target is None:
        return False
    path = Path(target)
    if _split_table(target) is not None:
        return True
    if is_dir(path):
        return not any(is_file(path / name) for name in ("run.json", "dataset.toml"))
    if not is_file(path):
        return False
    from needlefit.imaging.volume import ARCHIVE_SUFFIX, IMAGE_SUFFIXES, begins_as_dicom

    return path.name.lower().endswith((*IMAGE_SUFFIXES, ARCHIVE_SUFFIX)) or begins_as_dicom(path)


def open_session(target: str, named: Mapping[str, Any], recipe: str | None, folder: Path) -> "ScanSession":
    """Return the session of a scan; corrections are saved to a folder of its name in `folder`.

    `named` are files of a volume, by their keywords of `make_scans`; without a recipe that is `recipe.toml`
    in a folder with a table of scans, else the default. ConfigError, DataError if there is no such scan, or
    its files have a fault.
    """
    from needlefit.project.toml import load
    from needlefit.schemas.reconstruction import ReconstructionRecord
    from needlefit.viewer.scan_session import ScanSession

    scan, beside = _find_scan(target, named), _find_table_folder(Path(target))
    own = str(beside / "recipe.toml") if beside and is_file(beside / "recipe.toml") else None
    file = find_file("reconstruction", recipe or own or "default")
    return ScanSession(scan, load(file, ReconstructionRecord), file, folder / scan.id)


def _find_scan(target: str, named: Mapping[str, Any]) -> "Scan":
    from needlefit.imaging.scans import make_scans, read_scans

    table = _split_table(target)
    if table is None:
        return make_scans([Path(target)], **named)[0]
    if named:
        raise ConfigError(
            "a table of scans names its own files",
            where=str(table[0]),
            fix=f"leave out {', '.join(map(options.scan_option, named))}, or fill its columns",
        )
    scans = read_scans(table[0])
    chosen = [one for one in scans if one.id == table[1]] if table[1] else scans
    if len(chosen) != 1:
        known = ", ".join(one.id for one in scans)
        raise ConfigError(
            f"holds no scan {table[1]!r}" if table[1] else f"holds {len(scans)} scans",
            where=str(table[0]),
            expected=f"one of {known}",
            fix=f"needlefit view {table[0]}/{scans[0].id}",
        )
    return chosen[0]


def _split_table(target: str) -> tuple[Path, str] | None:
    """Return the table of scans and the id that a path or bare name means, with or without `/ID`."""
    path = Path(target)
    if target in list_names("scans"):
        return find_file("scans", target), ""
    if path.suffix.lower() == ".csv" and is_file(path):
        return path, ""
    if path.parent.suffix.lower() == ".csv" and is_file(path.parent):
        return path.parent, path.name
    if str(path.parent) in list_names("scans"):
        return find_file("scans", str(path.parent)), path.name
    folder = _find_table_folder(path)
    if folder is not None:
        return folder / "scans.csv", "" if folder == path else path.name
    return None


def _find_table_folder(path: Path) -> Path | None:
    """Return the folder with a table of scans that a path means, with or without `/ID`.

    The table is that of refused scans or of corrections; a result or a dataset is something else.
    """
    folder = path if path_exists(path) else path.parent
    others = ("run.json", "dataset.toml")
    found = is_file(folder / "scans.csv") and not any(is_file(folder / name) for name in others)
    return folder if found else None
