"""Several studies reported together -> a folder of files, complete or not there at all."""

from collections.abc import Sequence
from pathlib import Path

from needlefit.project.atomic_write import replace_folder
from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.files import all_files, write_json
from needlefit.reporting.inquiries.pages import PAGES
from needlefit.reporting.inquiries.write import cautions
from needlefit.reporting.overview import overview
from needlefit.reporting.write import draw_scores, write_for_papers, write_report, write_tables
from needlefit.validation.analyses.runner import AnalysisResult
from needlefit.validation.results import Results


def write_all(
    studies: Sequence[Results],
    tunings: Sequence[Results],
    folder: Path,
    answers: Sequence[AnalysisResult] = (),
) -> list[Path]:
    """Write the tables, figures and report of several studies together; return the files.

    `tunings` are the fits that fill the tuning tables; without any, each study's own fit does. Of `answers`,
    what else was asked, the report has what they say and their figures; their tables are in their folders.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as new:
        write_tables(studies, tunings or studies, new)
        drawn = draw_scores(studies, new)
        beyond = [block for answer in answers for block in _told(answer, new)]
        write_report(overview(studies, tunings or studies, drawn, beyond), new)
        every = [*studies, *tunings]
        write_for_papers(every, new)
        told = {one.name: one for one in every} | {one.name: one for one in answers}
        write_json(new / "run.json", {name: one.run for name, one in told.items()})
        write_json(new / "timing.json", {name: one.timing for name, one in told.items()})
    return all_files(folder)


def _told(answer: AnalysisResult, folder: Path) -> list[Block]:
    """Return an answer in short: question, what it says, its first figure; its own report has the others."""
    page = PAGES[answer.kind]
    (folder / answer.name).mkdir()
    drawn = page.draw(answer, folder / answer.name)
    told = [block for block in page.story(answer, drawn) if block["kind"] == "figure"][:1]
    return [
        document.heading(answer.title),
        *cautions(answer)[answer.synthetic :],  # that data are synthetic stands over the whole report
        *([document.text(answer.record.question)] if answer.record.question else []),
        document.bullets(page.said(answer)),
        *told,
    ]
