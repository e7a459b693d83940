"""A run's folder from what it stored, without computing anything again."""

from pathlib import Path

from needlefit.errors import DataError
from needlefit.project.places import PAPER_FITS, PAPER_STUDIES
from needlefit.project.records.study import StudyRecord
from needlefit.project.run_file import read_run
from needlefit.reporting.inquiries.write import write_answer
from needlefit.reporting.posterior import posterior_files
from needlefit.reporting.write import write, write_all
from needlefit.validation.inquiries.stored import is_answer, restore_answer
from needlefit.validation.packing import NAME
from needlefit.validation.results import Results
from needlefit.validation.stored import restore


def rebuild(run: Path, folder: Path) -> Path:
    """Write tables, figures and report of `run` to `folder`; return it.

    Raises
    ------
    DataError
        If the run stored no results, or one of several runs reported together is not that one any more.
    ConfigError
        If `folder` holds something that is no result.
    """
    if not (run / NAME).is_file() and (parts := _parts(run)):
        every = [_part(run, name, digest) for name, digest in parts.items()]
        studies = [one for one in every if isinstance(one.record, StudyRecord)]
        fits = [one for one in every if not isinstance(one.record, StudyRecord)]
        write_all(studies, fits, folder)
        return folder
    if is_answer(run):
        return write_answer(restore_answer(run), folder)
    results = restore(run)
    write(results, folder, posterior_files(results))
    return folder


def _parts(run: Path) -> dict[str, object]:
    """Return what was computed, by the name of its run, in the order of a report of several."""
    table = read_run(run)
    known = [name for name in (*PAPER_STUDIES, *PAPER_FITS) if name in table]
    return {name: table[name] for name in known} if len(known) == len(table) else {}


def _part(run: Path, name: str, computed: object) -> Results:
    folder = run.parent / name
    if read_run(folder) != computed:
        raise DataError(
            f"is not the run of which `{run.name}` tells",
            where=str(folder),
            mend="run `needlefit validate all` again, or report the single runs",
        )
    return restore(folder)
