"""A run's folder from what it stored, without computing anything again."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from needlefit.errors import DataError
from needlefit.project.input_files import convert_stored_errors, is_file
from needlefit.project.locate import PAPER_FITS, PAPER_STUDIES
from needlefit.project.run_file import holds_several_runs, read_run
from needlefit.reporting import forecast, identification
from needlefit.reporting.calibration import write_calibration
from needlefit.reporting.inquiries.write import write_answer
from needlefit.reporting.posterior import posterior_files
from needlefit.reporting.together import write_all
from needlefit.reporting.tracks.write import write_tracks
from needlefit.reporting.write import write
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
    """Write tables, figures and report of `run` to `folder`; return it.

    Raises
    ------
    DataError
        If the run stored no results, or one of several runs reported together is not that one any more.
    ConfigError
        If `folder` holds something that is no result.
    """
    with convert_stored_errors(run):
        return _again(run, folder)


def _again(run: Path, folder: Path) -> Path:
    if _is_group(run):
        every = restored(run)
        results = [one for one in every if isinstance(one, Results)]
        studies = [one for one in results if isinstance(one.record, StudyRecord)]
        fits = [one for one in results if not isinstance(one.record, StudyRecord)]
        write_all(studies, fits, folder, [one for one in every if isinstance(one, AnalysisResult)])
        return folder
    _refuse(run)
    if is_analysis_result(run):
        return write_answer(restore_result(run), folder)
    table = unpack(run)
    kind = table.get("kind")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise damage_error(run / RESULTS_FILE, "it is of no kind of run that this version knows")
    _KINDS[kind](table, run, folder)
    return folder


def _results(_: Table, run: Path, folder: Path) -> None:
    results = restore_results(run)
    write(results, folder, posterior_files(results))


_KINDS: Mapping[str, Callable[[Table, Path, Path], object]] = MappingProxyType(
    {
        "study": _results,
        "fit": _results,
        calibration.CALIBRATION_KIND: lambda table, run, folder: write_calibration(
            calibration.restore_calibration(table, run), folder
        ),
        tracks.TRACKS_KIND: lambda table, run, folder: write_tracks(
            tracks.restore_tracks(table, run), folder
        ),
        identification.KIND: lambda table, run, folder: identification.write_stages(
            identification.restored(table, run), folder
        ),
        forecast.KIND: lambda table, run, folder: forecast.write_foretold(
            forecast.restored(table, run), folder
        ),
    }
)
"""How each kind of run is written again, from the table that it stored."""

_IN_A_MOMENT = {
    "verification.csv": "needlefit verify",
    "material.json": "needlefit material FILE",
    "credibility.csv": "needlefit credibility RUN",
}
"""What only such a run writes, and how it is run: as fast as anything could be read again."""


def _refuse(run: Path) -> None:
    """Raise DataError for a run that stores nothing because it is computed again in a moment."""
    for file, command in _IN_A_MOMENT.items():
        if is_file(run / file):
            raise DataError(
                "stores no results: it is computed again as fast as they could be read",
                where=str(run),
                expected="a run of tune, validate, identify, predict or calibrate",
                fix=f"run `{command}` again",
            )


def restored(run: Path) -> list[Results | AnalysisResult]:
    """Return what a run stored: one, or each of several that were reported together.

    Raises
    ------
    DataError
        As `rebuild`.
    """
    if _is_group(run):
        return [_part(run, name, computed) for name, computed in _parts(run).items()]
    return [_restored(run)]


def _is_group(run: Path) -> bool:
    return not is_file(run / RESULTS_FILE) and bool(_parts(run))


def _restored(run: Path) -> Results | AnalysisResult:
    return restore_result(run) if is_analysis_result(run) else restore_results(run)


def _parts(run: Path) -> dict[str, object]:
    """Return what was computed, by the name of its run, in the order of a report of several."""
    table = read_run(run)
    if not holds_several_runs(table):
        return {}
    first = [name for name in (*PAPER_STUDIES, *PAPER_FITS) if name in table]
    return {name: table[name] for name in dict.fromkeys([*first, *table])}


def _part(run: Path, name: str, computed: object) -> Results | AnalysisResult:
    folder = run.parent / name
    if read_run(folder) != computed:
        raise DataError(
            f"is not the run of which `{run.name}` tells",
            where=str(folder),
            fix=f"run `needlefit validate {run.name}` again, or report the single runs",
        )
    return _restored(folder)
