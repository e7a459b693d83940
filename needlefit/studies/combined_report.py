"""Report several studies in one folder; the folder is complete, or it is not created."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from needlefit.project.folders import replace_folder
from needlefit.project.input_files import convert_stored_errors
from needlefit.reporting import document
from needlefit.reporting.document import Block, Document
from needlefit.reporting.latex import format_latex
from needlefit.reporting.table_files import all_files, write_csv, write_json
from needlefit.reporting.text import KindText
from needlefit.studies.fit_frames import FIT_KINDS
from needlefit.studies.kind import find_kind
from needlefit.studies.kinds.cross_validation import tables as fit_tables
from needlefit.studies.kinds.cross_validation.report import (
    draw_errors,
    format_macros,
    judge,
    lay_out_files,
    tuning_tables,
)
from needlefit.studies.report import (
    compose_warnings,
    label_figures,
    list_run_warnings,
    state_blocks,
    verdict_blocks,
    warning_blocks,
    write_report,
    write_run,
)
from needlefit.studies.run import MAX_FLOOR_RATIO, Run, headline_fault
from needlefit.studies.scored_groups import TE, list_held_out_groups
from needlefit.studies.store import is_combined, restore_runs

TEXT = KindText("combined")


def write_combined(runs: Sequence[Run], folder: Path) -> list[Path]:
    """Write the tables, figures and report of several studies together; return the files.

    The fits fill the tuning tables; without any, each study's own fit does. Of runs of other kinds the report
    has the summary and the first figure; their tables are in their folders.

    Raises ConfigError if `folder` holds anything that needlefit did not write, or that was changed since.
    """
    studies = [one for one in runs if one.kind == "cross_validation"]
    tunings = [one for one in runs if one.kind == "fit"] or studies
    others = [one for one in runs if one.kind not in FIT_KINDS]
    synthetic = any(one.synthetic for one in studies)
    with replace_folder(folder) as new:
        for name, frame, layouts in lay_out_files(studies, tunings):
            if len(frame):
                write_csv(frame, new / f"{name}.csv")
                pages = [format_latex(table, synthetic) for table in layouts if table.rows]
                (new / f"{name}.tex").write_text("\n".join(pages), encoding="utf-8")
        drawn = {name: one.save(new / f"{name}.pdf") for name, one in draw_errors(studies).items()}
        appendix = [block for result in others for block in _summarize_analysis(result, new)]
        report = compose_overview(studies, tunings, drawn, appendix)
        write_report(replace(report, unverified=any(one.unverified for one in runs)), new)
        label_figures(drawn, synthetic)
        every = [*studies, *(one for one in tunings if one not in studies)]
        (new / "numbers.tex").write_text(format_macros(every), encoding="utf-8")
        write_json(new / "run.json", {one.name: one.run_json for one in runs})
        write_json(new / "timing.json", {one.name: one.timing for one in runs})
    return all_files(folder)


def _summarize_analysis(result: Run, folder: Path) -> list[Block]:
    """Return a result in short: question, summary, first figure; its own report has the rest."""
    page = find_kind(result.kind).report
    (folder / result.name).mkdir()
    drawn, _ = page.draw(result, folder / result.name)
    every_run = [block for block in page.compose(result, drawn) if block["kind"] == "figure"][:1]
    return [
        document.heading(result.title),
        *warning_blocks(result)[result.synthetic :],  # that data are synthetic stands over the whole report
        *([document.text(result.question)] if result.question else []),
        *verdict_blocks(result),
        document.bullets(page.summarize(result)[1:]),
        *every_run,
    ]


def compose_overview(
    results: Sequence[Run], tunings: Sequence[Run], figures: dict[str, Path], appendix: Sequence[Block] = ()
) -> Document:
    """Return one report over all studies: one line, one table, one figure; then the details.

    `appendix` has the results of studies of other kinds.
    """
    fits = list({one.name: one for one in (*results, *tunings)}.values())
    predicted = [one for one in results if len(one.frames["predictive"])]
    tables = [
        *(fit_tables.lay_out_matrix(results, judge), fit_tables.lay_out_summary(results)),
        *(fit_tables.lay_out_parameters(fits, free_alone=True), fit_tables.lay_out_design(results)),
        *tuning_tables(tunings),
        *([fit_tables.lay_out_coverage(*predicted, named=True)] if predicted else []),
    ]
    groups, warned = [], list[Block]()
    for one in results:
        errors, name = one.frames["errors"], one.title.partition(":")[0]
        fitted = set(errors.loc[errors["role"] == "tune", "medium"])
        for group in list_held_out_groups(one):
            ratio = group.over_floor(TE)
            close = ratio is not None and ratio <= MAX_FLOOR_RATIO
            groups.append({"own": group.head["medium"] in fitted, "predicted": close})
        warned += [document.warning(f"{name}: {headline_fault(fault)}: {fault}.") for fault in one.faults]
        warned += compose_warnings(list_run_warnings(one), head=f"{name}: ")
    values = {
        "groups": groups,
        "predicted": bool(predicted),
        "questions": [f"{one.title}: {one.question}".rstrip(": ") for one in results],
    }
    printed = any(group.printed for group in list_held_out_groups(*results))
    known = {"facts": {"printed": printed}}
    captions = {name: fit_tables.TEXT.sentence(f"figure_{name}", known) for name in figures}
    blocks = {
        "answer": [document.verdict(TEXT.sentence("answer", values), "none")],
        "verdicts": [block for one in results for block in verdict_blocks(one, named=True)],
        "warnings": [document.subheading("Warnings"), *warned] if warned else [],
    }
    body = TEXT.compose("report", values, tables, figures, blocks, captions)
    states: list[Block] = []
    for block in (block for one in results for block in state_blocks(one)):
        states += [] if block in states else [block]
    data = "; ".join(dict.fromkeys(one.name if one.synthetic else one.dataset_title for one in results))
    synthetic = any(one.origin == "synthetic" for one in results)
    return Document("Validation studies", data, synthetic, (*states, *body, *appendix))


def rebuild(run: Path, folder: Path, unverified: bool = False, all_figures: bool = False) -> list[Run]:
    """Write tables, figures and report of a stored run to `folder` again, without any computation.

    Returns the run, or those reported together. Raises DataError if the run stored no results, they do not
    agree with their manifest (unless `unverified`), or one of several runs reported together is not that one
    any more; ConfigError if `folder` holds something that is no result.
    """
    with convert_stored_errors(run):
        runs = restore_runs(run, unverified)
        if is_combined(run):
            write_combined(runs, folder)
        else:
            write_run(runs[0], folder, all_figures)
        return runs
