"""Report several studies in one folder; the folder is complete, or it is not created."""

from collections.abc import Sequence
from pathlib import Path

from needlefit.project.atomic_write import replace_folder
from needlefit.reporting import document
from needlefit.reporting.analyses.result_folder import ANALYSIS_PAGES, analysis_warning_blocks
from needlefit.reporting.document import Block
from needlefit.reporting.run_folder import draw_error_figures, write_for_papers, write_report, write_tables
from needlefit.reporting.study_report import compose_overview
from needlefit.reporting.table_files import all_files, write_json
from needlefit.validation.analyses.runner import AnalysisResult
from needlefit.validation.results import Results


def write_combined(
    studies: Sequence[Results],
    tunings: Sequence[Results],
    folder: Path,
    analyses: Sequence[AnalysisResult] = (),
) -> list[Path]:
    """Write the tables, figures and report of several studies together; return the files.

    `tunings` are the fits that fill the tuning tables; without any, each study's own fit does. Of `analyses`,
    what else was asked, the report has what they say and their figures; their tables are in their folders.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as new:
        write_tables(studies, tunings or studies, new)
        drawn = draw_error_figures(studies, new)
        appendix = [block for result in analyses for block in _summarize_analysis(result, new)]
        write_report(compose_overview(studies, tunings or studies, drawn, appendix), new)
        every = [*studies, *tunings]
        write_for_papers(every, new)
        every_run = {one.name: one for one in every} | {one.name: one for one in analyses}
        write_json(new / "run.json", {name: one.run for name, one in every_run.items()})
        write_json(new / "timing.json", {name: one.timing for name, one in every_run.items()})
    return all_files(folder)


def _summarize_analysis(result: AnalysisResult, folder: Path) -> list[Block]:
    """Return a result in short: question, summary, first figure; its own report has the rest."""
    page = ANALYSIS_PAGES[result.kind]
    (folder / result.name).mkdir()
    drawn = page.draw(result, folder / result.name)
    every_run = [block for block in page.compose(result, drawn) if block["kind"] == "figure"][:1]
    return [
        document.heading(result.title),
        *analysis_warning_blocks(result)[
            result.synthetic :
        ],  # that data are synthetic stands over the whole report
        *([document.text(result.record.question)] if result.record.question else []),
        document.bullets(page.summarize(result)),
        *every_run,
    ]
