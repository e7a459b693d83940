"""Report several studies in one folder; the folder is complete, or it is not created."""

from collections.abc import Sequence
from pathlib import Path

from needlefit.project.folders import replace_folder
from needlefit.reporting import document
from needlefit.reporting.document import Document
from needlefit.reporting.latex import format_latex
from needlefit.reporting.table import TableLayout
from needlefit.reporting.table_files import write_csv, write_json
from needlefit.reporting.text import KindText
from needlefit.schemas.origin import ORIGIN_MARKS, combine_origins
from needlefit.studies import fit_tables
from needlefit.studies.report import compose_warnings, state_blocks, write_report
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import tabulate_errors

TEXT = KindText("combined")


def write_combined(runs: Sequence[Run], folder: Path) -> list[Path]:
    """Write the errors and the report of several studies together; return the files.

    The fits fill the table of in-sample errors; without any, each study's own fit does. Everything else, and
    studies of other kinds, stands in the folder of its run.

    Raises ConfigError if `folder` holds anything that needlefit did not write, or that was changed since.
    """
    studies = [run for run in runs if run.kind == "cross_validation"]
    tunings = [run for run in runs if run.kind == "fit"] or studies
    tabulated = {"validation": studies, "tuning": tunings}
    frames = {name: tabulate_errors(name, *some) for name, some in tabulated.items()}
    layouts = [fit_tables.lay_out_errors(name, *some) for name, some in tabulated.items()]
    layouts.insert(0, fit_tables.lay_out_matrix(studies))
    origin_mark = ORIGIN_MARKS[combine_origins(run.origin for run in studies)]
    with replace_folder(folder) as new:
        for name, frame in frames.items():
            if len(frame):
                write_csv(frame, new / f"{name}.csv")
        for table in layouts:
            if table.rows:
                (new / f"{table.name}.tex").write_text(format_latex(table, origin_mark), encoding="utf-8")
        write_report(compose_overview(runs, layouts), new)
        write_json(new / "run.json", {run.name: run.run_json for run in runs})
        write_json(new / "timing.json", {run.name: run.timing for run in runs})
    return sorted(path for path in folder.rglob("*") if path.is_file())


def compose_overview(runs: Sequence[Run], tables: Sequence[TableLayout]) -> Document:
    """Return one report over all studies: the data, the table of verdicts, the verdicts; then the rest."""
    studies = [run for run in runs if run.kind == "cross_validation"]
    pages = {run.name: run.first_page for run in studies}
    states = [block for page in pages.values() for block in state_blocks(page)]
    warned = [
        block
        for run in studies
        for block in (
            *(document.warning(f"{run.name}: {fault.kind}: {fault}.") for fault in run.faults),
            *compose_warnings(run.warnings, head=f"{run.name}: "),
        )
    ]
    blocks = {
        "verdicts": [
            document.verdict(f"{page.title.partition(':')[0]}. {page.verdict.sentence}.", page.verdict.status)
            for page in pages.values()
        ],
        "end_of_first_page": [document.page_break()],
        "warnings": [document.heading("Warnings"), *warned] if warned else [],
    }
    questions = [
        f"{page.title.partition(':')[0]}: {page.question}" for page in pages.values() if page.question
    ]
    body = TEXT.compose("report", {"questions": questions}, tables, {}, blocks)
    data = "; ".join(dict.fromkeys(run.name if run.origin_mark else run.dataset_title for run in studies))
    return Document(
        "Validation studies",
        data,
        ORIGIN_MARKS[combine_origins(run.origin for run in studies)],
        (*(block for n, block in enumerate(states) if block not in states[:n]), *body),
    )
