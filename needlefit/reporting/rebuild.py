"""Write a run's folder again from its stored results, without any computation."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from needlefit.errors import DataError
from needlefit.project.input_files import convert_stored_errors, is_file
from needlefit.project.locate import PAPER_FITS, PAPER_STUDIES
from needlefit.project.run_file import holds_several_runs, read_run
from needlefit.reporting import forecast, identification
from needlefit.reporting.analyses.result_folder import write_analysis
from needlefit.reporting.calibration import write_calibration
from needlefit.reporting.combined_report import write_combined
from needlefit.reporting.posterior import make_posterior_writers
from needlefit.reporting.run_folder import write
from needlefit.reporting.track_report import write_tracks
from needlefit.schemas.study import StudyRecord
from needlefit.validation.analyses.kinds import is_analysis_result, restore_result
from needlefit.validation.analyses.runner import AnalysisResult
from needlefit.validation.calibration import run as calibration
from needlefit.validation.packing import RESULTS_FILE, damage_error, unpack
from needlefit.validation.results import Results
from needlefit.validation.stored import restore_results
from needlefit.validation.tracks import results as tracks

Table = dict[str, Any]


def rebuild(run: Path, folder: Path) -> Path:
    """Write tables, figures and report of `run` to `folder`; return the folder.

    Raises
    ------
    DataError
        If the run stored no results, or one of several runs reported together is not that one any more.
    ConfigError
        If `folder` holds something that is no result.
    """
    with convert_stored_errors(run):
        return _rebuild(run, folder)


def _rebuild(run: Path, folder: Path) -> Path:
    if _is_combined(run):
        every = restore_run(run)
        results = [one for one in every if isinstance(one, Results)]
        studies = [one for one in results if isinstance(one.record, StudyRecord)]
        fits = [one for one in results if not isinstance(one.record, StudyRecord)]
        write_combined(studies, fits, folder, [one for one in every if isinstance(one, AnalysisResult)])
        return folder
    _refuse_quick_runs(run)
    if is_analysis_result(run):
        return write_analysis(restore_result(run), folder)
    table = unpack(run)
    kind = table.get("kind")
    if not isinstance(kind, str) or kind not in _REBUILDERS:
        raise damage_error(run / RESULTS_FILE, "it is of no kind of run that this version knows")
    _REBUILDERS[kind](table, run, folder)
    return folder


def _write_again(_: Table, run: Path, folder: Path) -> None:
    results = restore_results(run)
    write(results, folder, make_posterior_writers(results))


_REBUILDERS: Mapping[str, Callable[[Table, Path, Path], object]] = MappingProxyType(
    {
        "study": _write_again,
        "fit": _write_again,
        calibration.CALIBRATION_KIND: lambda table, run, folder: write_calibration(
            calibration.restore_calibration(table, run), folder
        ),
        tracks.TRACKS_KIND: lambda table, run, folder: write_tracks(
            tracks.restore_tracks(table, run), folder
        ),
        identification.IDENTIFICATION_KIND: lambda table, run, folder: (
            identification.write_stored_identification(
                identification.restore_identification(table, run), folder
            )
        ),
        forecast.FORECAST_KIND: lambda table, run, folder: forecast.write_stored_forecast(
            forecast.restore_forecast(table, run), folder
        ),
    }
)
"""The function that writes each kind of run again from its stored table."""

_QUICK_COMMANDS = {
    "verification.csv": "needlefit verify",
    "material.json": "needlefit material FILE",
    "credibility.csv": "needlefit credibility RUN",
}
"""Files that identify runs which store nothing, with the command that computes them again in a moment."""


def _refuse_quick_runs(run: Path) -> None:
    """Raise DataError for a run that stores nothing because it is computed again in a moment."""
    for file, command in _QUICK_COMMANDS.items():
        if is_file(run / file):
            raise DataError(
                "stores no results: it is computed again as fast as they could be read",
                where=str(run),
                expected="a run of tune, validate, identify, predict or calibrate",
                fix=f"run `{command}` again",
            )


def restore_run(run: Path) -> list[Results | AnalysisResult]:
    """Return the stored run, or each of several runs that were reported together.

    Raises
    ------
    DataError
        As `rebuild`.
    """
    if _is_combined(run):
        return [_restore_part(run, name, computed) for name, computed in _read_parts(run).items()]
    return [_restore(run)]


def _is_combined(run: Path) -> bool:
    return not is_file(run / RESULTS_FILE) and bool(_read_parts(run))


def _restore(run: Path) -> Results | AnalysisResult:
    return restore_result(run) if is_analysis_result(run) else restore_results(run)


def _read_parts(run: Path) -> dict[str, object]:
    """Return what was computed, by the name of its run, in the order of a report of several."""
    table = read_run(run)
    if not holds_several_runs(table):
        return {}
    first = [name for name in (*PAPER_STUDIES, *PAPER_FITS) if name in table]
    return {name: table[name] for name in dict.fromkeys([*first, *table])}


def _restore_part(run: Path, name: str, computed: object) -> Results | AnalysisResult:
    folder = run.parent / name
    # A run repeated since the report of several would mix two states of the data.
    if read_run(folder) != computed:
        raise DataError(
            f"is not the run of which `{run.name}` tells",
            where=str(folder),
            fix=f"run `needlefit validate {run.name}` again, or report the single runs",
        )
    return _restore(folder)
