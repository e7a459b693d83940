"""The report of a run: what every kind of study provides, and the folder that is written from it."""

import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import pandas as pd
from threadpoolctl import threadpool_limits

from needlefit.datasets.needles import describe_needles
from needlefit.project.folders import listed_files, replace_folder
from needlefit.project.help_pages import read_sections
from needlefit.project.input_files import convert_stored_errors
from needlefit.project.result_warnings import WARNINGS_KEY, ResultWarning, to_rows
from needlefit.reporting import document
from needlefit.reporting.document import Block, Document
from needlefit.reporting.figures import Drawing
from needlefit.reporting.slicer import write_needles
from needlefit.reporting.table import Table, TableLayout, format_latex
from needlefit.reporting.table_files import to_records, to_tidy, write_csv, write_json
from needlefit.reporting.text import KindText
from needlefit.schemas.origin import ORIGIN_MARKS, combine_origins
from needlefit.studies import fit_tables
from needlefit.studies.explorer import collect_explorer
from needlefit.studies.first_page import (
    METHOD,
    WHAT_TO_DO,
    FirstPage,
    Status,
    Verdict,
    lay_out_checks,
    list_failed,
    tabulate_checks,
)
from needlefit.studies.kind import find_kind
from needlefit.studies.run import (
    FIT_KINDS,
    Run,
    mark_faults,
    read_sources,
    restore_run,
    store_run,
    store_sources,
)
from needlefit.studies.scored_groups import tabulate_errors


def run_to_json(run: Run) -> dict[str, Any]:
    """Return what `--json` prints of a run."""
    return {
        "kind": run.kind,
        "name": run.name,
        "origin": run.origin,
        "dataset": run.dataset_title,
        "interrupted": run.interrupted,
        "faults": list(map(str, run.faults)),
        **run.first_page.to_json(),
        WARNINGS_KEY: to_rows(run.warnings),
        **find_report(run).to_json(run),
    }


@dataclass(frozen=True)
class StudyReport:
    """How the runs of one kind of study are reported: a text, and what it prints; callables take the run."""

    #: its block `verdict` is the answer; `summary` holds further sentences, `report` the body of the report,
    #: `table_<name>` the caption and the notes of a table, `figure_<name>` the caption of a figure
    text: KindText
    values: Callable[[Run], Mapping[str, Any]]  #: run -> the numbers and names that the text prints
    #: run -> its tables, which are also written as LaTeX
    tables: Callable[[Run], Sequence[Table | TableLayout]]
    #: run -> its figures by name, those of the first page first: forms with their frames, which are
    #: written as CSV beside them
    figures: Callable[[Run], Mapping[str, Drawing]] = lambda run: {}
    #: run -> its first page; `Run.first_page`, which adds what every run has, is what others call
    first_page: Callable[[Run], FirstPage] = lambda run: begin_first_page(run, "none")
    #: run -> its files: tables, which are written as CSV, by name; texts by the names of their files
    files: Callable[[Run], Mapping[str, pd.DataFrame | str]] = lambda run: run.frames
    #: run -> what `--json` prints besides the answer
    to_json: Callable[[Run], dict[str, Any]] = lambda run: {
        name: to_records(to_tidy(frame)) for name, frame in run.frames.items()
    }
    #: whether other files that needlefit wrote to the folder stay when the result is written again
    keeps_files: bool = False
    first_figures: int = 1  #: number of figures on the first page

    def summarize(self, run: Run) -> list[str]:
        """Return the sentences about a run, the most important first."""
        values = self.values(run)
        return [*self.text.sentences("verdict", values), *self.text.sentences("summary", values)]

    def lay_out(self, run: Run) -> list[TableLayout]:
        """Return the tables of a run."""
        values = self.values(run)
        return [
            table if isinstance(table, TableLayout) else self.text.lay_out(table, values)
            for table in self.tables(run)
        ]

    def draw(self, run: Run, folder: Path) -> dict[str, Path]:
        """Draw the figures of a run to a folder, with what each shows as CSV; return the files by name."""
        return {
            name: figure.save(folder / f"{name}.pdf", run.origin)
            for name, figure in self.figures(run).items()
        }

    def write(self, run: Run, folder: Path) -> Path:
        """Write a result, as `write_run`; called by `Run.save`, which cannot import this module."""
        return write_run(run, folder)

    def format_notebook_html(self, run: Run) -> str:
        """Return what a notebook shows of a run: its first page, then its tables and warnings."""
        page = run.first_page
        shown, blocks = [table.name for table in page.tables], compose_first_page(page)
        if not run.interrupted:  # of an interrupted one only what is finished is laid out
            blocks += [document.table(table) for table in self.lay_out(run) if table.name not in shown]
        blocks += compose_warnings(run.warnings, linked=False)
        return document.format_html_part(
            Document(page.title, page.introduction, page.origin_mark, tuple(blocks))
        )


def find_report(run: Run) -> StudyReport:
    """Return how the runs of a run's kind are reported."""
    report: StudyReport = find_kind(run.kind).load("report").REPORT
    return report


def begin_first_page(run: Run, status: Status, **numbers: float | str | None) -> FirstPage:
    """Return the first page of a kind: the first sentence of its summary, and its first table."""
    report = find_report(run)
    sentence = report.summarize(run)[0]
    return FirstPage(Verdict(sentence.rstrip("."), status, numbers), tables=report.lay_out(run)[:1])


def recall(run: Run) -> str:
    """Return how a run's verdict opens, and the checks that failed: they stand before uses of its fit."""
    page = find_report(run).first_page(run)
    failed = list_failed(page.checks)
    words = f" Failed checks: {'; '.join(failed)}." if failed else ""
    return f"{run.name}: {mark_faults(run.faults)}{page.verdict.opening}.{words}"


def compose_first_page(page: FirstPage, pictures: Sequence[Block] = ()) -> list[Block]:
    """Return a first page as blocks; what must be read before any number stands first."""
    checks, advice = lay_out_checks(page.checks), page.advice
    first_table, *fitted = (document.table(table) for table in page.tables) if page.tables else (None,)
    return [
        *state_blocks(page),
        document.verdict(f"{page.verdict.sentence}.", page.verdict.status),
        *(document.warning(f"{fault.kind}: {fault}.") for fault in page.faults),
        *compose_warnings(page.warnings),
        *([first_table] if first_table else []),
        *pictures,
        *([document.table(checks)] if checks.rows else []),
        *fitted,
        *([document.paragraph(WHAT_TO_DO, advice.sentence, advice.format_command())] if advice else []),
        *([document.paragraph(METHOD, page.method)] if page.method else []),
    ]


def write_run(run: Run, folder: Path) -> Path:
    """Write the result of an analysis to `folder`, replacing an earlier result there; return the folder.

    Every frame as CSV, tables as LaTeX, figures as PDF,
    the report as PDF and HTML, `run.json`, `results.json.gz`, from which all of this can be made again, and
    `timing.json`.

    Raises ConfigError if `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with threadpool_limits(1, user_api="blas"), replace_folder(folder) as new:
        for name in listed_files(folder) if find_report(run).keeps_files else ():
            (new / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / name, new / name)
        write_files(run, new)
    return folder


def rebuild(stored: Path, folder: Path) -> Run:
    """Write tables, figures and report of a stored run to `folder` again, without any computation.

    Raises DataError if the run stored no results, or they do not agree with their manifest; ConfigError if
    `folder` holds something that is no result.
    """
    with convert_stored_errors(stored):
        run = restore_run(stored)
        if folder.resolve() != stored.resolve():
            sources = store_sources(read_sources(run.timing, stored), folder)
            run = replace(run, timing={**run.timing, **sources})
        write_run(run, folder)
        return run


def list_run_files(run: Run) -> dict[str, pd.DataFrame | str]:
    """Return the checks and the files of a result, as `StudyReport.files`."""
    return {"checks": tabulate_checks(run.first_page.checks), **find_report(run).files(run)}


def write_files(run: Run, folder: Path) -> None:
    """Write the files of a result, as `write_run`, into a folder that takes the place of another."""
    page = find_report(run)
    figures = page.draw(run, folder)
    for name, file in list_run_files(run).items():
        if isinstance(file, str):
            (folder / name).write_text(file, encoding="utf-8")
        elif name not in figures and len(file.columns):
            # of a frame that a figure shows, the figure's is the file
            rows = file if "origin" in file else file.assign(origin=run.origin)
            write_csv(rows, folder / f"{name}.csv")
    for table in page.lay_out(run):
        path = folder / f"{table.name}.tex"
        path.write_text(format_latex(table, run.origin_mark), encoding="utf-8")
    if "needles" in run.frames and len(run.frames["needles"]):
        write_needles(run.frames["needles"], run.origin_mark, folder / "slicer")
    store_run(run, folder)
    report = compose_run_report(run, figures)
    write_report(report, folder)
    label_figures(figures.values(), run.origin_mark)
    write_json(folder / "run.json", run.run_json)
    write_json(folder / "timing.json", run.timing)


def label_figures(figures: Iterable[Path], origin_mark: str) -> None:
    """Write the mark of data that were not measured above figures that stand alone; a report has it once."""
    if origin_mark:
        for path in figures:
            path.write_bytes(document.label_figure(path, origin_mark))


def write_report(report: Document, folder: Path) -> None:
    """Write a report as PDF and as HTML; it ends with the sections that its warnings link to."""
    report = replace(report, blocks=(*report.blocks, *_help_blocks(report.blocks)))
    (folder / "report.pdf").write_bytes(document.compile_pdf(report))
    (folder / "report.html").write_bytes(document.compile_html(report))


def compose_run_report(run: Run, figures: Mapping[str, Path]) -> Document:
    """Return the report: the first page, then everything else once."""
    report, page = find_report(run), run.first_page
    shown, values = {table.name for table in page.tables}, report.values(run)
    tables = [table for table in report.lay_out(run) if table.name not in shown]
    pictures = {
        name: document.figure(path, report.text.sentence(f"figure_{name}", values))
        for name, path in figures.items()
    }
    first = [pictures.pop(name) for name in list(figures)[: report.first_figures]]
    blocks = [
        *compose_first_page(page, first),
        document.page_break(),
        *report.text.compose(values, tables, pictures),
        *compose_warnings(warning for warning in run.warnings if warning not in page.warnings),
        *_run_blocks(run),
    ]
    return Document(page.title, page.introduction, page.origin_mark, tuple(blocks), collect_explorer(run))


def compose_warnings(warnings: Iterable[ResultWarning], linked: bool = True, head: str = "") -> list[Block]:
    """Return warnings, each linked to its section of the report, or with the command that prints it."""
    return [
        document.warning(f"Warning: {head}{warning}.", (warning.help_key, "What to do"))
        if linked
        else document.warning(f"Warning: {head}{warning} ({warning.help_command}).")
        for warning in warnings
    ]


def _help_blocks(blocks: Iterable[Block]) -> Iterator[Block]:
    """Yield the sections of the page on troubleshooting that warnings link to, each once."""
    keys = dict.fromkeys(block["target"] for block in blocks if block["kind"] == "warning")
    for number, section in enumerate(read_sections()[key] for key in keys if key):
        if not number:
            yield document.heading("What the warnings mean")
        yield document.subheading(section.title, section.key)
        for is_item, texts in groupby(section.paragraphs, lambda words: words.startswith("- ")):
            if is_item:
                yield document.bullets([words.removeprefix("- ") for words in texts])
            else:
                yield from map(document.text, texts)


def state_blocks(page: FirstPage) -> list[Block]:
    """Return what must be read before any number: not measured, interrupted."""
    blocks = [document.origin(page.origin_note)] if page.origin_note else []
    if page.interrupted:
        part = "Some of the work was left undone."
        blocks.append(document.warning(f"INTERRUPTED. {part}"))
    return blocks


def _run_blocks(run: Run) -> list[Block]:
    """Return the note of a study and its settings; what the report shows elsewhere is left to run.json."""
    stated = ("dataset", "datasets", "recipe", "rules", "versions")
    metadata = run.run_json
    settings = {key: _format_value(metadata[key]) for key in stated if key in metadata}
    if (identity := run.metadata.identity) is not None:
        settings["identity"] = _format_value(identity.sha256)
    rows = [{"setting": key, "setting_value": line} for key, line in settings.items() if line]
    if not rows:
        return []
    caption = f"Settings of {run.name}. The file run.json holds all of them."
    table = Table("run", rows, ("setting", "setting_value"), caption=caption).lay_out()
    note = getattr(run.record, "note", "")
    return [*([document.text(note)] if note else []), document.table(table)]


def list_data_notes(run: Run) -> list[str]:
    """Return the needles of the data, where there are several, and what its makers want known."""
    if (data := run.metadata.dataset) is None:
        return []
    return [*([describe_needles(data.needles)] if data.needles else []), *data.notes]


_OMITTED_DATA_KEYS = ("notes", "origin", "rigidity")  #: keys of a dataset that stand elsewhere in a report


def _format_value(value: object) -> str:
    """Return a value of run.json on one line; digests are cut, notes stand elsewhere."""
    if isinstance(value, Mapping):
        pairs = (
            (str(key), _format_value(item))
            for key, item in sorted(value.items())
            if key not in _OMITTED_DATA_KEYS
        )
        return "; ".join(f"{key.replace('_', ' ')} {line}" for key, line in pairs if line)
    if isinstance(value, list | tuple):
        return ", ".join(_format_value(item) for item in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}"
    words = "" if value is None else str(value)
    return f"{words[:16]}…" if len(words) >= 40 and " " not in words else words


# ---- several studies

COMBINED = KindText("combined")


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
    body = COMBINED.compose({"questions": questions}, tables, {}, blocks)
    data = "; ".join(dict.fromkeys(run.name if run.origin_mark else run.dataset_title for run in studies))
    return Document(
        "Validation studies",
        data,
        ORIGIN_MARKS[combine_origins(run.origin for run in studies)],
        (*(block for n, block in enumerate(states) if block not in states[:n]), *body),
    )


# ---- reference results

LENGTH_DECIMALS = 5  #: number of decimals of a length in mm
SIGNIFICANT_DIGITS = 5  #: number of significant digits of all other numbers
#: largest number of rows of a table that is kept: longer ones are intermediate results that nobody reviews
MAX_ROWS = 500


def write_reference(run: Run, folder: Path) -> Path:
    """Write the tables of a run, rounded, and its `run.json` to `folder`; return it.

    Raises ConfigError if `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as new:
        tables = {name: file for name, file in list_run_files(run).items() if not isinstance(file, str)}
        for name in REVIEWED_TABLES.get(run.kind, tables):
            frame = to_tidy(tables.get(name, pd.DataFrame()))
            if 0 < len(frame) <= MAX_ROWS:
                write_csv(round_frame(frame).assign(origin=run.origin), new / f"{name}.csv")
        table = dict(run.run_json)
        for name in ("source_revision", "validity"):  # they differ from machine to machine
            table.pop(name, None)
        write_json(new / "run.json", table)
    return folder


def round_frame(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a frame with lengths rounded to 0.00001 mm and other numbers to five significant digits."""
    return frame.assign(**{str(name): _round_column(frame[name], str(name)) for name in frame})


REVIEWED_TABLES = {
    **dict.fromkeys(FIT_KINDS, ("checks", "validation", "tuning", "parameters", "errors", "predictive")),
}
"""Tables that are kept, by kind; of other kinds all are."""


def _round_column(column: pd.Series, name: str) -> pd.Series:
    if not pd.api.types.is_float_dtype(column):
        return column
    if name.endswith("_mm"):
        return column.round(LENGTH_DECIMALS) + 0.0  # no −0
    return column.map(lambda value: float(f"{value:.{SIGNIFICANT_DIGITS}g}"))
