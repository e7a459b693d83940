"""Write the report of a study of tip tracks: tables, sentences, files."""

from pathlib import Path

import pandas as pd

from needlefit.inference.sampling.posterior import save
from needlefit.project.atomic_write import replace_folder
from needlefit.reporting import document
from needlefit.reporting.document import Document, compile_pdf
from needlefit.reporting.figures.tracks import draw_tracks
from needlefit.reporting.labels import METHOD_NAMES, medium_name
from needlefit.reporting.number_format import format_mm, format_number, format_symbol, typeset
from needlefit.reporting.table_files import write_csv, write_json
from needlefit.reporting.table_layout import TableColumn, TableLayout, text_column
from needlefit.reporting.tables import Row, to_records
from needlefit.validation.tracks.results import (
    METHODS,
    TrackResults,
    compare_methods_by_run,
    posterior_file,
    store_tracks,
    tabulate_by_depth,
    tabulate_coverage,
)

TRACK_METHOD_NAMES = {**METHOD_NAMES, "constant_curvature": "parabola"}
PRINTED_MEASURES = ("rms_mm", "aligned_rms_mm")
"""The measures of `summary.MEASURES` that the table of scores shows."""

_PARAMETER_NOTES = (
    "Percentiles of the posterior. “SD ratio” is its deviation over that of prior and bounds, in ln: where "
    "it "
    "is near 1, the percentiles repeat what was put in.",
    "Moduli are for the needle that the dataset assumes: μ / EI is what the runs speak of.",
)
_SCORE_NOTES = (
    "“Error”: root mean square over the scored readings of the median predicted, mean over runs. Each run "
    "lies in the tracker’s frame as its own readings up to {placed:g} mm, and the slopes of the runs fitted "
    "to, say it does, for all baselines alike.",
    "“Shape”: what remains when the best shift and slope of the scored readings themselves are taken off, "
    "which forgives the frame, and whatever is straight.",
    "Δ is the method’s minus the fit’s; in brackets its 95 % interval over runs (Student). Runs into one "
    "phantom share a fit: the interval is for further runs into it.",
)
_COVERAGE_NOTES = (
    "Last readings within the interval predicted for them, and tracks of which no scored reading left the "
    "band predicted for them as a whole. In brackets the 95 % interval of the share (Wilson), of runs; over "
    "all, of phantoms as trials, which is next to nothing where they are few.",
)


def lay_out_parameters(results: TrackResults) -> TableLayout:
    """Return the estimate of each parameter from the fitted runs."""
    rows = tuple(
        (
            *(str(row["fit"]), format_symbol(row["parameter"])),
            *(typeset(format_number(row[at])) for at in ("p2_5", "p50", "p97_5")),
            *(format_mm(row["sd_ratio"]), "determined" if row["determined"] else "not determined"),
        )
        for row in to_records(results.parameters)
    )
    columns = (
        *(
            text_column("Fit"),
            text_column("Parameter"),
            TableColumn("2.5 %"),
            TableColumn("50 %"),
            TableColumn("97.5 %"),
        ),
        *(TableColumn("SD ratio"), text_column("Verdict")),
    )
    return TableLayout("parameters", "What the runs fitted to tell.", columns, rows, notes=_PARAMETER_NOTES)


def lay_out_scores(results: TrackResults) -> TableLayout:
    """Return the prediction errors of every method on the same runs."""
    rows = []
    for medium, group in compare_methods_by_run(results).groupby("medium", sort=False):
        for method in METHODS:
            by_key = {str(row["measure"]): row for row in to_records(group[group["method"] == method])}
            head = (
                medium_name(str(medium)),
                str(by_key[PRINTED_MEASURES[0]]["runs"]),
                TRACK_METHOD_NAMES[method],
            )
            rows.append(
                (
                    *head,
                    *(
                        cell
                        for one in PRINTED_MEASURES
                        for cell in _difference_cells(by_key[one], method == "fitted")
                    ),
                )
            )
    columns = (
        *(text_column("Predicted"), TableColumn("Runs"), text_column("By")),
        *(TableColumn("Error", "mm"), TableColumn("Δ", "mm"), TableColumn("Fit better", "on")),
        *(TableColumn("Shape", "mm"), TableColumn("Δ", "mm"), TableColumn("Fit better", "on")),
    )
    strong = tuple(range(0, len(rows), len(METHODS)))
    notes = (_SCORE_NOTES[0].format(placed=results.record.registration_depth_mm), *_SCORE_NOTES[1:])
    return TableLayout("scores", "Runs predicted.", columns, tuple(rows), strong[1:], strong, notes)


def lay_out_depths(results: TrackResults) -> TableLayout:
    """Return how prediction errors grow with depth."""
    table = tabulate_by_depth(results)
    depth_ranges = sorted(set(zip(table["from_mm"], table["to_mm"], strict=True)))
    rows = []
    for medium, group in table.groupby("medium", sort=False):
        for method in METHODS:
            method_rows = group[group["method"] == method]
            known = dict(zip(method_rows["from_mm"], method_rows["error_mm"], strict=True))
            cells = (format_mm(known.get(low)) for low, _ in depth_ranges)
            rows.append((medium_name(str(medium)), TRACK_METHOD_NAMES[method], *cells))
    columns = (
        text_column("Predicted"),
        text_column("By"),
        *(TableColumn(f"{low:g}–{high:g}", "mm") for low, high in depth_ranges),
    )
    strong = tuple(range(0, len(rows), len(METHODS)))
    caption = "Mean size of the error of the medians predicted, by depth."
    return TableLayout("depths", caption, columns, tuple(rows), strong[1:], strong)


def lay_out_coverage(results: TrackResults) -> TableLayout:
    """Return the coverage of predictive intervals: of last readings, and of whole tracks (a run is one
    trial).
    """
    rows = []
    for (medium, method), group in tabulate_coverage(results).groupby(["medium", "method"], sort=False):
        by_key = {(row["quantity"], row["level"]): row for row in to_records(group)}
        shares = tuple(
            _format_share(by_key[quantity, level]) for quantity in ("end", "track") for level in (50, 95)
        )
        rows.append((medium_name(str(medium)), TRACK_METHOD_NAMES[str(method)], *shares))
    columns = (
        *(text_column("Predicted"), text_column("By")),
        *(
            TableColumn(f"{quantity} in", f"{level} %")
            for quantity in ("Ends", "Tracks")
            for level in (50, 95)
        ),
    )
    strong = tuple(range(0, len(rows), len(METHODS)))
    return TableLayout(
        "coverage", "How often it held.", columns, tuple(rows), strong[1:], strong, _COVERAGE_NOTES
    )


def _difference_cells(row: Row, own: bool) -> tuple[str, str, str]:
    if own:
        return format_mm(row["mean_mm"]), "", ""
    low, high = (format_mm(row[f"difference_{end}_mm"]) for end in ("low", "high"))
    difference = f"{format_mm(row['difference_mm'])} ({low} to {high})".replace("-", "−")
    return format_mm(row["mean_mm"]), difference, f"{row['better']} of {row['runs']}"


def _format_share(row: Row) -> str:
    return f"{row['covered']} of {row['runs']} ({100 * row['low']:.0f}–{100 * row['high']:.0f} %)"


_MEASURE_NAMES = {"rms_mm": "predicted", "aligned_rms_mm": "in shape"}


def list_cautions(results: TrackResults) -> tuple[str, ...]:
    """Return the warnings to read before the numbers: missing convergence, runs left out."""
    return (*(f"NOT CONVERGED: {fault}." for fault in results.faults), *results.remarks)


def summarize_tracks(results: TrackResults) -> tuple[str, ...]:
    """Return one sentence per medium: the fit compared with the baselines."""
    paired = compare_methods_by_run(results)
    return tuple(
        _summarize_medium(str(medium), group) for medium, group in paired.groupby("medium", sort=False)
    )


def _summarize_medium(medium: str, group: pd.DataFrame) -> str:
    parts = [
        f"{_MEASURE_NAMES[one]}, {_compare_methods(group[group['measure'] == one])}"
        for one in PRINTED_MEASURES
    ]
    return f"{medium_name(medium)}: {'; '.join(parts)}."


def _compare_methods(group: pd.DataFrame) -> str:
    """Return the comparison of the fit with each method: better or worse if the interval excludes 0."""
    verdicts: dict[str, list[str]] = {}
    for row in to_records(group[group["method"] != "fitted"]):
        low, high = row["difference_low_mm"], row["difference_high_mm"]
        word = "better than" if low > 0 else "worse than" if high < 0 else "not significantly different from"
        verdicts.setdefault(word, []).append(f"the {TRACK_METHOD_NAMES[str(row['method'])]}")
    return "the fit is " + ", ".join(f"{word} {' and '.join(names)}" for word, names in verdicts.items())


_READINGS_CAPTION = (
    "Tip readings (points; hollow: they say how the run lies in the tracker’s frame) and what was predicted "
    "of them: the fitted model’s median with 50 and 95 % bands (blue), a straight line (grey) and a parabola "
    "(green). Below each: the guide’s place on the way to each reading, mm. Bands may leave the panels."
)


def write_tracks(results: TrackResults, folder: Path) -> Path:
    """Write tables, figure, posteriors and report to `folder`, replacing an earlier result there.

    Raises
    ------
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as new:
        frames = {"runs": results.runs, "parameters": results.parameters}
        frames |= {"paired": compare_methods_by_run(results), "coverage": tabulate_coverage(results)}
        frames["depths"] = tabulate_by_depth(results)
        for name, frame in frames.items():
            write_csv(frame.assign(origin=results.origin), new / f"{name}.csv")
        for fit, posterior in results.posteriors.items():
            save(posterior, new / posterior_file(fit))
        drawn = draw_tracks(results.readings.assign(origin=results.origin), new / "readings.pdf")
        (new / "report.pdf").write_bytes(compile_pdf(_compose_report(results, drawn)))
        store_tracks(results, new)
        write_json(new / "run.json", results.run | {"not_converged": list(results.faults)})
        write_json(new / "timing.json", results.timing)
    return folder


def _compose_report(results: TrackResults, drawn: Path) -> Document:
    synthetic = results.origin == "synthetic"
    blocks = (
        *(document.warning(f"NOT CONVERGED: {fault}.") for fault in results.faults),
        *document.run_warning_blocks(results.run, results.name),
        document.text(results.record.question),
        document.bullets([*summarize_tracks(results), *results.remarks]),
        document.heading("Runs predicted"),
        document.table(lay_out_scores(results), synthetic),
        document.table(lay_out_depths(results), synthetic),
        document.table(lay_out_coverage(results), synthetic),
        document.figure(drawn, _READINGS_CAPTION, synthetic),
        document.heading("What was learned"),
        document.table(lay_out_parameters(results), synthetic),
        document.heading("What was assumed"),
        document.bullets([one for one in (results.record.note, *results.notes) if one]),
    )
    return Document(results.title, f"{results.name} · {results.dataset_title}", synthetic, blocks)
