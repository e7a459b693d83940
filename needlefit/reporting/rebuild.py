"""A run's folder from what it stored, without computing anything again."""

from pathlib import Path

from needlefit.errors import DataError
from needlefit.project.places import PAPER_FITS, PAPER_STUDIES
from needlefit.project.records.study import StudyRecord
from needlefit.project.run_file import read_run
from needlefit.reporting.inquiries.write import write_answer
from needlefit.reporting.posterior import posterior_files
from needlefit.reporting.together import write_all
from needlefit.reporting.write import write
from needlefit.validation.inquiries.answer import Answer
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
        every = [_part(run, name, computed) for name, computed in parts.items()]
        results = [one for one in every if isinstance(one, Results)]
        studies = [one for one in results if isinstance(one.record, StudyRecord)]
        fits = [one for one in results if not isinstance(one.record, StudyRecord)]
        write_all(studies, fits, folder, [one for one in every if isinstance(one, Answer)])
        return folder
    found = _restored(run)
    if isinstance(found, Answer):
        return write_answer(found, folder)
    write(found, folder, posterior_files(found))
    return folder


def _restored(run: Path) -> Results | Answer:
    return restore_answer(run) if is_answer(run) else restore(run)


def _parts(run: Path) -> dict[str, object]:
    """Return what was computed, by the name of its run, in the order of a report of several."""
    table = read_run(run)
    if not all(isinstance(part, dict) for part in table.values()):  # of a single run some are words
        return {}
    first = [name for name in (*PAPER_STUDIES, *PAPER_FITS) if name in table]
    return {name: table[name] for name in dict.fromkeys([*first, *table])}


def _part(run: Path, name: str, computed: object) -> Results | Answer:
    folder = run.parent / name
    if read_run(folder) != computed:
        raise DataError(
            f"is not the run of which `{run.name}` tells",
            where=str(folder),
            mend=f"run `needlefit validate {run.name}` again, or report the single runs",
        )
    return _restored(folder)
