"""Report several studies in one folder; the folder is complete, or it is not created."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from needlefit.project.folders import replace_folder
from needlefit.reporting import document
from needlefit.reporting.document import Document
from needlefit.reporting.latex import format_latex
from needlefit.reporting.table import TableLayout
from needlefit.reporting.table_files import write_csv, write_json
from needlefit.reporting.text import KindText
from needlefit.studies import fit_tables
from needlefit.studies.fit_figures import draw_groups
from needlefit.studies.report import compose_warnings, label_figures, state_blocks, write_report
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import tabulate_tuning, tabulate_validation

TEXT = KindText("combined")


def write_combined(runs: Sequence[Run], folder: Path) -> list[Path]:
    """Write the errors, the figure and the report of several studies together; return the files.

    The fits fill the table of in-sample errors; without any, each study's own fit does. Everything else, and
    studies of other kinds, stands in the folder of its run.

    Raises ConfigError if `folder` holds anything that needlefit did not write, or that was changed since.
    """
    studies = [one for one in runs if one.kind == "cross_validation"]
    tunings = [one for one in runs if one.kind == "fit"] or studies
    frames = {"validation": tabulate_validation(*studies), "tuning": tabulate_tuning(*tunings)}
    layouts = [
        fit_tables.lay_out_matrix(studies),
        fit_tables.lay_out_validation(*studies),
        fit_tables.lay_out_tuning(*tunings),
    ]
    synthetic = any(one.synthetic for one in studies)
    with replace_folder(folder) as new:
        for name, frame in frames.items():
            if len(frame):
                write_csv(frame, new / f"{name}.csv")
        for table in layouts:
            if table.rows:
                (new / f"{table.name}.tex").write_text(format_latex(table, synthetic), encoding="utf-8")
        drawn = {"groups": draw_groups(studies).save(new / "groups.pdf")} if len(frames["validation"]) else {}
        write_report(compose_overview(runs, layouts, drawn), new)
        label_figures(drawn, synthetic)
        write_json(new / "run.json", {one.name: one.run_json for one in runs})
        write_json(new / "timing.json", {one.name: one.timing for one in runs})
    return sorted(path for path in folder.rglob("*") if path.is_file())


def compose_overview(
    runs: Sequence[Run], tables: Sequence[TableLayout], figures: Mapping[str, Path]
) -> Document:
    """Return one report over all studies: the table of verdicts, one figure, the verdicts; then the rest."""
    studies = [one for one in runs if one.kind == "cross_validation"]
    warned = [
        block
        for one in studies
        for block in (
            *(document.warning(f"{one.name}: {fault.kind}: {fault}.") for fault in one.faults),
            *compose_warnings(one.warnings, head=f"{one.name}: "),
        )
    ]
    blocks = {
        "verdicts": [
            document.verdict(f"{one.title.partition(':')[0]}. {verdict.sentence}.", verdict.status)
            for one in studies
            for verdict in one.verdicts[:1]
        ],
        "warnings": [document.heading("Warnings"), *warned] if warned else [],
    }
    questions = [f"{one.title}: {one.question}".rstrip(": ") for one in studies]
    body = TEXT.compose("report", {"questions": questions}, tables, figures, blocks)
    states = [block for one in studies for block in state_blocks(one)]
    states = [block for n, block in enumerate(states) if block not in states[:n]]
    data = "; ".join(dict.fromkeys(one.name if one.synthetic else one.dataset_title for one in studies))
    return Document(
        "Validation studies",
        data,
        any(one.synthetic for one in studies),
        (*states, *body),
    )
