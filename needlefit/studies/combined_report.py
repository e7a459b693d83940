"""Report several studies in one folder; the folder is complete, or it is not created."""

from collections.abc import Sequence
from pathlib import Path

from needlefit.project.folders import replace_folder
from needlefit.project.result_warnings import read_warnings
from needlefit.reporting import document
from needlefit.reporting.document import Block, Document
from needlefit.reporting.latex import format_latex
from needlefit.reporting.table_files import all_files, write_csv, write_json
from needlefit.reporting.text import KindText
from needlefit.studies import fit_tables
from needlefit.studies.fit_figures import draw_errors
from needlefit.studies.fit_frames import FIT_KINDS
from needlefit.studies.kind import find_kind
from needlefit.studies.report import (
    compose_first_figure,
    compose_warnings,
    label_figures,
    state_blocks,
    subtitle,
    write_report,
)
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import list_held_out_groups

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
        for name, frame, layouts in fit_tables.lay_out_files(studies, tunings):
            if len(frame):
                write_csv(frame, new / f"{name}.csv")
                pages = [format_latex(table, synthetic) for table in layouts if table.rows]
                (new / f"{name}.tex").write_text("\n".join(pages), encoding="utf-8")
        drawn = {name: one.save(new / f"{name}.pdf") for name, one in draw_errors(studies).items()}
        appendix = [block for result in others for block in _summarize_analysis(result, new)]
        report = compose_overview(studies, tunings, drawn, appendix)
        write_report(report, new)
        label_figures(drawn, synthetic)
        every = [*studies, *(one for one in tunings if one not in studies)]
        (new / "numbers.tex").write_text(fit_tables.format_macros(every), encoding="utf-8")
        write_json(new / "run.json", {one.name: one.run_json for one in runs})
        write_json(new / "timing.json", {one.name: one.timing for one in runs})
    return all_files(folder)


def _summarize_analysis(result: Run, folder: Path) -> list[Block]:
    """Return a result in short: what was asked, the answer, first figure; its own report has the rest."""
    (folder / result.name).mkdir()
    drawn, _ = find_kind(result.kind).report.draw(result, folder / result.name)
    return [
        document.heading(result.title),
        document.text(subtitle(result)),
        *(document.verdict(f"{one.sentence}.", one.status) for one in result.verdicts[:1]),
        *compose_first_figure(result, drawn),
    ]


def compose_overview(
    results: Sequence[Run], tunings: Sequence[Run], figures: dict[str, Path], appendix: Sequence[Block] = ()
) -> Document:
    """Return one report over all studies: the table of verdicts, the verdicts, one figure; then the details.

    `appendix` has the results of studies of other kinds.
    """
    fits = list({one.name: one for one in (*results, *tunings)}.values())
    predicted = [one for one in results if len(one.frames["predictive"])]
    tables = [
        *(fit_tables.lay_out_matrix(results), fit_tables.lay_out_summary(*results)),
        *(fit_tables.lay_out_parameters(*fits), fit_tables.lay_out_design(results)),
        *fit_tables.lay_out_tuning(tunings),
        *([fit_tables.lay_out_coverage(*predicted, named=True)] if predicted else []),
    ]
    printed = any(group.printed for group in list_held_out_groups(*results))
    values = {
        "predicted": bool(predicted),
        "questions": [f"{one.title}: {one.question}".rstrip(": ") for one in results],
    }
    captions = {name: fit_tables.TEXT.sentence(f"figure_{name}", {"printed": printed}) for name in figures}
    warned = [
        block
        for one in results
        for block in (
            *(document.warning(f"{one.name}: {fault.kind}: {fault}.") for fault in one.faults),
            *compose_warnings(read_warnings(one.run), head=f"{one.name}: "),
        )
    ]
    blocks = {
        "verdicts": [
            document.verdict(f"{one.title.partition(':')[0]}. {verdict.sentence}.", verdict.status)
            for one in results
            for verdict in one.verdicts[:1]
        ],
        "warnings": [document.subheading("Warnings"), *warned] if warned else [],
    }
    body = TEXT.compose("report", values, tables, figures, blocks, captions)
    states: list[Block] = []
    for block in (block for one in results for block in state_blocks(one)):
        states += [] if block in states else [block]
    data = "; ".join(dict.fromkeys(one.name if one.synthetic else one.dataset_title for one in results))
    synthetic = any(one.origin == "synthetic" for one in results)
    return Document("Validation studies", data, synthetic, (*states, *body, *appendix))
