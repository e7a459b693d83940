"""An answer -> a folder of files, complete or not there at all."""

from pathlib import Path

from needlefit.project.atomic_write import replace_folder
from needlefit.reporting import document
from needlefit.reporting.comparability import SYNTHETIC
from needlefit.reporting.display import Display, text
from needlefit.reporting.document import Block, Document
from needlefit.reporting.files import write_csv, write_json
from needlefit.reporting.inquiries.page import Figures
from needlefit.reporting.inquiries.pages import PAGES
from needlefit.reporting.latex import latex
from needlefit.reporting.macros import table_macros
from needlefit.reporting.sentences import run_said
from needlefit.reporting.write import write_report
from needlefit.validation.analyses.kinds import store_result
from needlefit.validation.analyses.runner import AnalysisResult

MADE_UP = "The needles were made by the model itself: how it fares on them says nothing of real ones."
"""Of synthetic data that are not the twin's."""


def write_answer(answer: AnalysisResult, folder: Path) -> Path:
    """Write one inquiry's answer to `folder`, replacing an earlier result there; return it.

    Every frame as CSV, tables and their numbers as LaTeX, figures as PDF, the report as PDF and HTML,
    `run.json`, `results.json.gz`, from which all of this can be made again, and `timing.json`.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    page = PAGES[answer.kind]
    with replace_folder(folder) as new:
        for name, frame in answer.frames.items():
            write_csv(frame.assign(origin=answer.origin), new / f"{name}.csv")
        tables = page.layouts(answer)
        for table in tables:
            (new / f"{table.name}.tex").write_text(latex(table, answer.synthetic), encoding="utf-8")
        (new / "numbers.tex").write_text(table_macros(answer.name, tables), encoding="utf-8")
        write_report(report(answer, page.draw(answer, new)), new)
        store_result(answer, new)
        write_json(new / "run.json", answer.run)
        write_json(new / "timing.json", answer.timing)
    return folder


def report(answer: AnalysisResult, figures: Figures) -> Document:
    """Return the report: what was asked and answered, what is behind it, what it was computed with."""
    page = PAGES[answer.kind]
    blocks = [
        *cautions(answer),
        document.bullets(page.said(answer)),
        document.heading("Question"),
        *(document.text(words) for words in (answer.record.question, answer.record.note) if words),
        *page.story(answer, figures),
        *_run(answer),
    ]
    subtitle = f"{answer.name} · {answer.dataset_title}"
    return Document(answer.title, subtitle, answer.synthetic, tuple(blocks))


def cautions(answer: AnalysisResult) -> list[Block]:
    """Return what a reader must know before any number."""
    said = []
    if answer.synthetic:
        of_twin = "twin" in answer.run["datasets"]
        why = SYNTHETIC.removeprefix("Synthetic data: ").capitalize() if of_twin else MADE_UP
        said.append(document.warning(f"SYNTHETIC DATA. {why}"))
    if answer.interrupted:
        said.append(document.warning("INTERRUPTED. Some of the work was left undone; what is here is part."))
    said += [document.warning(f"NOT TO BE TRUSTED: {fault}.") for fault in answer.faults]
    return said + document.warnings_in(answer.run, answer.name)


def _run(answer: AnalysisResult) -> list[Block]:
    head = (text("What"), text("Value", wide=True))
    rows = tuple(run_said({key: answer.run[key] for key in ("versions", "datasets") if key in answer.run}))
    table = Display("run", f"What {answer.name} was computed with.", head, rows)
    return [
        document.heading("Run"),
        document.text("The file run.json holds all of this in full; the same inputs give the same bytes."),
        document.table(table, answer.synthetic),
    ]
