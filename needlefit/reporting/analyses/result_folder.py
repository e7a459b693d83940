"""Write an analysis result as a folder of files; the folder is complete, or it is not created."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from needlefit.project.atomic_write import replace_folder
from needlefit.reporting import document
from needlefit.reporting.analyses import (
    adaptation,
    comparison,
    left_out,
    next_insertion,
    plan,
    seeds,
    sensitivity,
    specimens,
)
from needlefit.reporting.analyses.page import AnalysisPage, FigurePaths
from needlefit.reporting.comparability import SYNTHETIC_NOTE
from needlefit.reporting.document import Block, Document
from needlefit.reporting.latex import format_latex, format_table_macros
from needlefit.reporting.run_folder import write_report
from needlefit.reporting.sentences import describe_run
from needlefit.reporting.table_files import write_csv, write_json
from needlefit.reporting.table_layout import TableLayout, text_column
from needlefit.validation.analyses.kinds import store_result
from needlefit.validation.analyses.runner import AnalysisResult

ANALYSIS_PAGES: Mapping[str, AnalysisPage] = MappingProxyType(
    {
        "adaptation": adaptation.PAGE,
        "comparison": comparison.PAGE,
        "left_out": left_out.PAGE,
        "next_insertion": next_insertion.PAGE,
        "plan": plan.PAGE,
        "seeds": seeds.PAGE,
        "sensitivity": sensitivity.PAGE,
        "specimens": specimens.PAGE,
    }
)


MODEL_DATA_NOTE = "The needles were made by the model itself: how it fares on them says nothing of real ones."
"""Of synthetic data that are not the twin's."""


def write_analysis(result: AnalysisResult, folder: Path) -> Path:
    """Write the result of an analysis to `folder`, replacing an earlier result there; return the folder.

    Every frame as CSV, tables and their numbers as LaTeX, figures as PDF, the report as PDF and HTML,
    `run.json`, `results.json.gz`, from which all of this can be made again, and `timing.json`.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    page = ANALYSIS_PAGES[result.kind]
    with replace_folder(folder) as new:
        for name, frame in result.frames.items():
            write_csv(frame.assign(origin=result.origin), new / f"{name}.csv")
        tables = page.lay_out(result)
        for table in tables:
            (new / f"{table.name}.tex").write_text(format_latex(table, result.synthetic), encoding="utf-8")
        (new / "numbers.tex").write_text(format_table_macros(result.name, tables), encoding="utf-8")
        write_report(compose_analysis_report(result, page.draw(result, new)), new)
        store_result(result, new)
        write_json(new / "run.json", result.run)
        write_json(new / "timing.json", result.timing)
    return folder


def compose_analysis_report(result: AnalysisResult, figures: FigurePaths) -> Document:
    """Return the report: question, results, method, provenance."""
    page = ANALYSIS_PAGES[result.kind]
    blocks = [
        *analysis_warning_blocks(result),
        document.bullets(page.summarize(result)),
        document.heading("Question"),
        *(document.text(words) for words in (result.record.question, result.record.note) if words),
        *page.compose(result, figures),
        *_run_blocks(result),
    ]
    subtitle = f"{result.name} · {result.dataset_title}"
    return Document(result.title, subtitle, result.synthetic, tuple(blocks))


def analysis_warning_blocks(result: AnalysisResult) -> list[Block]:
    """Return the warnings that must be read before any number."""
    blocks = []
    if result.synthetic:
        of_twin = "twin" in result.run["datasets"]
        why = SYNTHETIC_NOTE.removeprefix("Synthetic data: ").capitalize() if of_twin else MODEL_DATA_NOTE
        blocks.append(document.warning(f"SYNTHETIC DATA. {why}"))
    if result.interrupted:
        blocks.append(
            document.warning("INTERRUPTED. Some of the work was left undone; what is here is part.")
        )
    blocks += [document.warning(f"NOT TO BE TRUSTED: {fault}.") for fault in result.faults]
    return blocks + document.run_warning_blocks(result.run, result.name)


def _run_blocks(result: AnalysisResult) -> list[Block]:
    head = (text_column("What"), text_column("Value", wide=True))
    rows = tuple(
        describe_run({key: result.run[key] for key in ("versions", "datasets") if key in result.run})
    )
    table = TableLayout("run", f"What {result.name} was computed with.", head, rows)
    return [
        document.heading("Run"),
        document.text("The file run.json holds all of this in full; the same inputs give the same bytes."),
        document.table(table, result.synthetic),
    ]
