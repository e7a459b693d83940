"""Report several studies in one folder; the folder is complete, or it is not created."""

from collections.abc import Sequence
from pathlib import Path

from needlefit.project.atomic_write import replace_folder
from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.table_files import all_files, write_json
from needlefit.studies.kind import find_kind
from needlefit.studies.kinds.cross_validation.files import (
    draw_error_figures,
    write_for_papers,
    write_tables,
)
from needlefit.studies.kinds.cross_validation.report import compose_overview
from needlefit.studies.kinds.cross_validation.results import FIT_KINDS
from needlefit.studies.report import label_figures, verdict_blocks, warning_blocks, write_report
from needlefit.studies.run import Run


def write_combined(
    runs: Sequence[Run],
    folder: Path,
) -> list[Path]:
    """Write the tables, figures and report of several studies together; return the files.

    The fits fill the tuning tables; without any, each study's own fit does. Of runs of other kinds the report
    has the summary and the first figure; their tables are in their folders.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    studies = [one for one in runs if one.kind == "cross_validation"]
    tunings = [one for one in runs if one.kind == "fit"]
    others = [one for one in runs if one.kind not in FIT_KINDS]
    with replace_folder(folder) as new:
        write_tables(studies, tunings or studies, new)
        drawn = draw_error_figures(studies, new)
        appendix = [block for result in others for block in _summarize_analysis(result, new)]
        write_report(compose_overview(studies, tunings or studies, drawn, appendix), new)
        every = [*studies, *tunings]
        label_figures(drawn, any(one.synthetic for one in studies))
        write_for_papers(every, new)
        write_json(new / "run.json", {one.name: one.run_json for one in runs})
        write_json(new / "timing.json", {one.name: one.timing for one in runs})
    return all_files(folder)


def _summarize_analysis(result: Run, folder: Path) -> list[Block]:
    """Return a result in short: question, summary, first figure; its own report has the rest."""
    page = find_kind(result.kind).report
    (folder / result.name).mkdir()
    drawn = page.draw(result, folder / result.name)
    every_run = [block for block in page.compose(result, drawn) if block["kind"] == "figure"][:1]
    return [
        document.heading(result.title),
        *warning_blocks(result)[result.synthetic :],  # that data are synthetic stands over the whole report
        *([document.text(result.question)] if result.question else []),
        *verdict_blocks(result),
        document.bullets(page.summarize(result)[1:]),
        *every_run,
    ]
