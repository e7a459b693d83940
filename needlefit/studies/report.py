"""The report of a run: what every kind of study provides, and the folder that is written from it."""

import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import pandas as pd
from threadpoolctl import threadpool_limits

from needlefit.project.folders import listed_files, replace_folder
from needlefit.project.help_pages import read_sections
from needlefit.project.result_warnings import WARNINGS_KEY, ResultWarning, read_warnings, to_rows
from needlefit.reporting import document
from needlefit.reporting.document import Block, Document
from needlefit.reporting.figures import Drawing
from needlefit.reporting.labels import SYNTHETIC_NOTE
from needlefit.reporting.latex import format_latex
from needlefit.reporting.needle_page import PageData
from needlefit.reporting.number_format import join_words
from needlefit.reporting.table import Table, TableLayout
from needlefit.reporting.table_files import to_records, to_tidy, write_csv, write_json
from needlefit.reporting.text import KindText
from needlefit.studies.fit_warnings import QUALIFYING_WARNINGS
from needlefit.studies.kind import find_kind
from needlefit.studies.run import (
    STATUSES,
    VERDICTS_KEY,
    Run,
    Status,
    Verdict,
    headline_fault,
    judge_run,
    verdicts_to_json,
)
from needlefit.studies.store import store_run


def run_to_json(result: Run) -> dict[str, Any]:
    """Return what `--json` prints of a run."""
    return {
        "kind": result.kind,
        "name": result.name,
        "origin": result.origin,
        "dataset": result.dataset_title,
        "interrupted": result.interrupted,
        "faults": list(result.faults),
        VERDICTS_KEY: verdicts_to_json(judge_run(result)),
        WARNINGS_KEY: to_rows(list_run_warnings(result)),
        **find_kind(result.kind).report.to_json(result),
    }


def judge_by_summary(result: Run) -> list[Verdict]:
    """Return the first sentence of the summary as the verdict; warnings make it "warn" at best."""
    report = find_kind(result.kind).report
    warned: Status = "warn" if read_warnings(result.run) else "none"
    status = max(report.rate(result), warned, key=STATUSES.index)
    return [Verdict(sentence.rstrip("."), status) for sentence in report.summarize(result)[:1]]


def list_run_warnings(result: Run) -> tuple[ResultWarning, ...]:
    """Return the warnings of a run, those that qualify the verdict first."""
    found = read_warnings(result.run)
    return tuple(sorted(found, key=lambda one: one.kind not in QUALIFYING_WARNINGS))


@dataclass(frozen=True)
class StudyReport:
    """How the runs of one kind of study are reported: a text, and what it prints; callables take the run."""

    #: its block `verdict` is the answer; `summary` holds further sentences, `report` the body of the report,
    #: `table_<name>` the caption and the notes of a table, `figure_<name>` the caption of a figure
    text: KindText
    values: Callable[[Run], Mapping[str, Any]]  #: result -> the numbers and names that the text prints
    #: result -> its tables, which are also written as LaTeX
    tables: Callable[[Run], Sequence[Table | TableLayout]]
    #: result -> its figures by name: forms with their frames, which are written as CSV beside them
    figures: Callable[[Run], Mapping[str, Drawing]] = lambda result: {}
    #: result -> blocks by name, to which the text refers
    blocks: Callable[[Run], Mapping[str, list[Block]]] = lambda result: {}
    #: result -> tables that only the report has
    more_tables: Callable[[Run], Sequence[Table | TableLayout]] = lambda result: ()
    #: result -> the tables that are written as CSV, by name
    tabulate: Callable[[Run], Mapping[str, pd.DataFrame]] = lambda result: result.frames
    #: result and folder: writes what the kind has besides tables, figures and report
    write_files: Callable[[Run, Path], None] = lambda result, folder: None
    #: whether other files that needlefit wrote to the folder stay when the result is written again
    keeps_files: bool = False
    #: result -> what `--json` prints, without verdicts and warnings
    to_json: Callable[[Run], dict[str, Any]] = lambda result: {
        name: to_records(to_tidy(frame)) for name, frame in result.frames.items()
    }
    #: result -> its verdicts; `judge_run` (`studies/run.py`) is what others call
    judge: Callable[[Run], list[Verdict]] = judge_by_summary
    #: result -> the status of its verdict, where that is the first sentence of its summary
    rate: Callable[[Run], Status] = lambda result: "none"
    #: result -> the needles that the HTML page computes (`Document.explorer`)
    explore: Callable[[Run], PageData | None] = lambda result: None
    #: result -> the tables that terminal and first page show under the verdict, without their notes
    lay_out_first: Callable[[Run], list[TableLayout]] = lambda result: find_kind(result.kind).report.lay_out(
        result
    )[:1]
    #: result -> the tables and sentences that `--explain` prints: all of them unless a kind has more
    explain: Callable[[Run], tuple[list[TableLayout], list[str]]] = lambda result: (
        find_kind(result.kind).report.lay_out(result),
        find_kind(result.kind).report.summarize(result),
    )
    #: a fault of a run -> what stands before its verdicts; empty where a verdict itself names the fault
    headline: Callable[[str], str] = headline_fault

    def summarize(self, result: Run) -> list[str]:
        """Return the sentences about a run, the most important first."""
        values = self.values(result)
        return [*self.text.sentences("verdict", values), *self.text.sentences("summary", values)]

    def say(self, result: Run, block: str) -> str:
        """Return a block of the text about a run, as one line; "" if there is none."""
        return self.text.sentence(block, self.values(result))

    def lay_out(self, result: Run, *, more: bool = False) -> list[TableLayout]:
        """Return the tables of a run, with `more` all those of its report."""
        values = self.values(result)
        every = [*self.tables(result), *(self.more_tables(result) if more else ())]
        return [one if isinstance(one, TableLayout) else self.text.lay_out(one, values) for one in every]

    def draw(self, result: Run, folder: Path, all_figures: bool = True) -> tuple[dict[str, Path], list[str]]:
        """Write what each figure shows to a folder, as CSV; draw all, or those that are not optional.

        Return the files by name, and the names of the figures that are not drawn.
        """
        every = self.figures(result)
        drawn = {name: one for name, one in every.items() if all_figures or not one.optional}
        left = [name for name in every if name not in drawn]
        for name in left:
            write_csv(every[name].frame, folder / f"{name}.csv")
        return {name: one.save(folder / f"{name}.pdf") for name, one in drawn.items()}, left

    def compose(self, result: Run, paths: Mapping[str, Path]) -> list[Block]:
        """Return the body of the report, with figures that were drawn to `paths`."""
        tables, blocks = self.lay_out(result, more=True), self.blocks(result)
        return self.text.compose("report", self.values(result), tables, paths, blocks)

    def write(self, result: Run, folder: Path) -> Path:
        """Write a result, as `write_run`; called by `Run.save`, which cannot import this module."""
        return write_run(result, folder)

    def format_notebook_html(self, result: Run) -> str:
        """Return what a notebook shows of a run: title, warnings, results in words, tables."""
        warned = compose_warnings(list_run_warnings(result), linked=False)
        blocks = state_blocks(result) + _fault_blocks(result)
        if result.interrupted and result.kind != "fit":
            blocks += warned
        else:  # of the others only what is finished is laid out
            blocks += [document.bullets(self.summarize(result)), *warned]
            blocks += [document.table(table) for table in self.lay_out(result)]
        subtitle, marked = f"{result.name} · {result.dataset_title}", bool(result.unverified)
        return document.format_html_part(
            Document(result.title, subtitle, result.synthetic, tuple(blocks), unverified=marked)
        )


def say(result: Run, *blocks: str) -> str:
    """Return blocks of the text of a run's kind, as one line."""
    page = find_kind(result.kind).report
    return " ".join(words for block in blocks if (words := page.say(result, block)))


#: of synthetic data that are not the twin's
MODEL_DATA_NOTE = "The needles were simulated: errors on them do not carry over to measured ones."


def write_run(result: Run, folder: Path, all_figures: bool = False) -> Path:
    """Write the result of an analysis to `folder`, replacing an earlier result there; return the folder.

    Every frame as CSV, tables as LaTeX, figures as PDF (optional ones with `all_figures`),
    the report as PDF and HTML, `run.json`, `results.json.gz`, from which all of this can be made again, and
    `timing.json`.

    Raises ConfigError if `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with threadpool_limits(1, user_api="blas"), replace_folder(folder) as new:
        for name in listed_files(folder) if find_kind(result.kind).report.keeps_files else ():
            (new / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / name, new / name)
        write_files(result, new, all_figures)
    return folder


def write_files(result: Run, folder: Path, all_figures: bool = False) -> None:
    """Write the files of a result, as `write_run`, into a folder that takes the place of another."""
    from needlefit.reporting.figures.style import draw_together  # late: matplotlib takes its time to load

    page = find_kind(result.kind).report
    with draw_together() as begin_drawing:
        figures, left = page.draw(result, folder, all_figures)
        begin_drawing()
        frames = page.tabulate(result)
        for name, frame in frames.items():
            if name in (*figures, *left):  # of a frame that a figure shows, the figure's is the file
                continue
            rows = frame if "origin" in frame else frame.assign(origin=result.origin)
            write_csv(rows, folder / f"{name}.csv")
        for table in page.lay_out(result):
            path = folder / f"{table.name}.tex"
            path.write_text(format_latex(table, result.synthetic), encoding="utf-8")
        page.write_files(result, folder)
        store_run(result, folder)
        report = compose_run_report(result, figures, left)
    write_report(report, folder)
    label_figures(figures, result.synthetic)
    write_json(folder / "run.json", result.run_json)
    write_json(folder / "timing.json", result.timing)


def label_figures(figures: Mapping[str, Path], synthetic: bool) -> None:
    """Write "Synthetic data" above figures that stand alone; within a report the page says it."""
    if synthetic:
        for path in figures.values():
            path.write_bytes(document.label_figure(path))


def write_report(report: Document, folder: Path, name: str = "report") -> None:
    """Write a report as PDF and as HTML; it ends with the sections that its warnings link to."""
    report = replace(report, blocks=(*report.blocks, *_help_blocks(report.blocks)))
    (folder / f"{name}.pdf").write_bytes(document.compile_pdf(report))
    (folder / f"{name}.html").write_bytes(document.compile_html(report))


def compose_run_report(result: Run, figures: Mapping[str, Path], left: Sequence[str] = ()) -> Document:
    """Return the report: question, verdicts, results, method, provenance; `left` are figures not drawn."""
    page = find_kind(result.kind).report
    warnings = list_run_warnings(result)
    sentences = page.summarize(result)[1:] if page.judge is judge_by_summary else []
    blocks = [
        *state_blocks(result),
        *verdict_blocks(result),
        *([document.bullets(sentences)] if sentences else []),
        *_fault_blocks(result),
        *compose_warnings(one for one in warnings if one.kind in QUALIFYING_WARNINGS),
        *page.compose(result, figures),
        *compose_warnings(one for one in warnings if one.kind not in QUALIFYING_WARNINGS),
        *_run_blocks(result),
    ]
    if left:
        words = f"needlefit report {result.name} --figures all also draws {join_words(left)}."
        blocks.append(document.note(words))
    data = "" if result.synthetic else f" · {result.dataset_title}"  # the first block names synthetic data
    subtitle = f"{result.name}{data}. {result.question}".strip()
    found, marked = page.explore(result), bool(result.unverified)
    return Document(result.title, subtitle, result.synthetic, tuple(blocks), found, marked)


def verdict_blocks(result: Run, named: bool = False) -> list[Block]:
    """Return the verdict on each group of a run, with the run's name if wanted."""
    head = f"{result.title.partition(':')[0]}: " if named else ""
    return [document.verdict(f"{head}{one.sentence}.", one.status) for one in judge_run(result)]


def warning_blocks(result: Run) -> list[Block]:
    """Return what must be read before any number, and the warnings."""
    return state_blocks(result) + _fault_blocks(result) + compose_warnings(list_run_warnings(result))


def compose_warnings(warnings: Iterable[ResultWarning], linked: bool = True, head: str = "") -> list[Block]:
    """Return warnings, each linked to its section of the report, or with the command that prints it."""
    return [
        document.warning(f"Warning: {head}{one}.", (one.help_key, "What to do"))
        if linked
        else document.warning(f"Warning: {head}{one} ({one.help_command}).")
        for one in warnings
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


def state_blocks(result: Run) -> list[Block]:
    """Return what must be read before any number: synthetic, interrupted."""
    blocks = []
    if result.synthetic:
        names = result.run.get("datasets") or [result.run.get("dataset", {}).get("name")]
        of_twin = SYNTHETIC_NOTE.removeprefix("Synthetic data: ").capitalize()
        blocks.append(document.warning(f"Synthetic data. {of_twin if 'twin' in names else MODEL_DATA_NOTE}"))
    if result.interrupted:
        part = "Some of the work was left undone; what is here is part."
        blocks.append(document.warning(f"INTERRUPTED. {part}"))
    return blocks


def _fault_blocks(result: Run) -> list[Block]:
    headline = find_kind(result.kind).report.headline
    heads = [f"{head}: " if (head := headline(fault)) else "" for fault in result.faults]
    pairs = zip(heads, result.faults, strict=True)
    return [document.warning(f"{head}{result.name}: {fault}.") for head, fault in pairs]


def _run_blocks(result: Run) -> list[Block]:
    """Return the note of a study and its settings; what the report shows elsewhere is left to run.json."""
    stated = ("dataset", "datasets", "recipe", "rules", "versions")
    settings = {key: _format_value(result.run[key]) for key in stated if key in result.run}
    rows = [{"setting": key, "setting_value": line} for key, line in settings.items() if line]
    if not rows:
        return []
    caption = f"Settings of {result.name}. The file run.json holds all of them."
    table = Table("run", rows, ("setting", "setting_value"), caption=caption).lay_out()
    return [*([document.text(result.note)] if result.note else []), document.table(table)]


_OMITTED_DATA_KEYS = ("notes", "origin")  #: of a dataset: they stand elsewhere in a report


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
