"""Write a run's folder again from its stored results, without any computation."""

from pathlib import Path

from needlefit.errors import DataError
from needlefit.project.input_files import convert_stored_errors, is_file
from needlefit.project.locate import PAPER_FITS, PAPER_STUDIES
from needlefit.project.run_file import holds_several_runs, read_run
from needlefit.studies.combined_report import write_combined
from needlefit.studies.packing import RESULTS_FILE
from needlefit.studies.report import write_run
from needlefit.studies.run import Run, restore_run


def rebuild(run: Path, folder: Path) -> list[Run]:
    """Write tables, figures and report of `run` to `folder`; return the run, or those reported together.

    Raises
    ------
    DataError
        If the run stored no results, or one of several runs reported together is not that one any more.
    ConfigError
        If `folder` holds something that is no result.
    """
    with convert_stored_errors(run):
        runs = restore_runs(run)
        if _is_combined(run):
            write_combined(runs, folder)
        else:
            write_run(runs[0], folder)
        return runs


def restore_runs(run: Path) -> list[Run]:
    """Return the stored run, or each of several runs that were reported together.

    Raises
    ------
    DataError
        As `rebuild`.
    """
    if _is_combined(run):
        return [_restore_part(run, name, computed) for name, computed in _read_parts(run).items()]
    return [restore_run(run)]


def _is_combined(run: Path) -> bool:
    return not is_file(run / RESULTS_FILE) and bool(_read_parts(run))


def _read_parts(run: Path) -> dict[str, object]:
    """Return what was computed, by the name of its run, in the order of a report of several."""
    table = read_run(run)
    if not holds_several_runs(table):
        return {}
    first = [name for name in (*PAPER_STUDIES, *PAPER_FITS) if name in table]
    return {name: table[name] for name in dict.fromkeys([*first, *table])}


def _restore_part(run: Path, name: str, computed: object) -> Run:
    folder = run.parent / name
    # A run repeated since the report of several would mix two states of the data.
    if read_run(folder) != computed:
        raise DataError(
            f"is not the run that `{run.name}` reports",
            where=str(folder),
            fix=f"run `needlefit validate {run.name}` again, or report the single runs",
        )
    return restore_run(folder)
