"""Report of an adaptation: how many insertions a new specimen needs."""

from pathlib import Path

from needlefit.reporting import document
from needlefit.reporting.columns import DIGITS
from needlefit.reporting.document import Block
from needlefit.reporting.labels import APPROACH_NAMES, medium_name
from needlefit.reporting.number_format import format_mm
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.kinds.adaptation.figures import draw_curves
from needlefit.studies.kinds.adaptation.schema import AdaptationRecord
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run
from needlefit.studies.score import list_length_metrics

_COUNTS = ("n", "low", "high")
_TARGETS = {"all": "error after all of them", "floor": "noise floor"}


def summarize(result: Run) -> list[str]:
    """Return sentences: how many insertions a new specimen needs, the use of the old posterior, and what
    intervals cover.
    """
    parts = (
        _describe_cost,
        _describe_floor,
        _describe_no_update,
        _describe_gains,
        _describe_coverage,
        _describe_limits,
    )
    return [part(result) for part in parts]


def lay_out_tables(result: Run) -> list[TableLayout]:
    """Return the learning curves as a table, with the number of insertions from which errors are small
    enough.
    """
    return [_lay_out_curves(result), _lay_out_insertions_needed(result)]


def _record(result: Run) -> AdaptationRecord:
    assert isinstance(result.record, AdaptationRecord)
    return result.record


def _name_new(result: Run) -> str:
    """Return what the new insertions went into: the one specimen that is named, or the medium."""
    new = _record(result).new
    named = new.insertions.specimens or ()
    return medium_name(named[0].replace("-", " ") if len(named) == 1 else new.medium)


def _select_rows(result: Run, frame: str, **keys: object) -> list[Row]:
    rows = to_records(result.frames[frame])
    return [row for row in rows if all(row[key] == value for key, value in keys.items())]


def _describe_cost(result: Run) -> str:
    """Return how many insertions it takes, or that more of them do not pay."""
    by_approach = {
        row["method"]: row for row in _select_rows(result, "insertions_needed", metric="te_mm", target="all")
    }
    record, most = _record(result), int(result.frames["adaptation"]["n"].max())
    every, none = (
        by_approach["new"]["value"],
        _select_rows(result, "adaptation", method="none")[0]["te_mm"],
    )
    if by_approach["none"]["n"] == 0:
        return (
            f"{_name_new(result).capitalize()} needs no insertion: mean held-out tip error (TE) "
            f"{format_mm(none, 3)} mm without an update, {format_mm(every, 3)} mm after {most} insertions "
            "into it."
        )
    return (
        f"{_name_new(result).capitalize()} needs {_format_count(by_approach['inflated'], most)} with the "
        f"widened posterior of {medium_name(record.old.medium)}, {_format_count(by_approach['new'], most)} "
        f"without it, to keep the mean held-out tip error (TE) within {record.margin_mm:g} mm of that of all "
        f"{most} ({format_mm(every, 3)} mm)."
    )


def _describe_floor(result: Run) -> str:
    by_approach = {
        row["method"]: row
        for row in _select_rows(result, "insertions_needed", metric="te_mm", target="floor")
    }
    most = int(result.frames["adaptation"]["n"].max())
    return (
        f"To keep the TE within {_record(result).margin_mm:g} mm of the noise floor "
        f"({format_mm(by_approach['new']['value'], 3)} mm) it needs "
        f"{_format_count(by_approach['inflated'], most)} with the widened posterior, "
        f"{_format_count(by_approach['new'], most)} without it."
    )


def _format_count(row: Row, most: int) -> str:
    """Return a count of insertions with its interval."""
    n, low, high = (f"more than {most}" if row[end] is None else f"{row[end]:.0f}" for end in _COUNTS)
    count = f"{n} insertion{'' if row['n'] == 1 else 's'}"
    return count if low == high else f"{count} ({low} to {high})"


def _describe_no_update(result: Run) -> str:
    none = _select_rows(result, "adaptation", method="none")[0]
    return (
        f"Without an update the TE is {format_mm(none['te_mm'], 3)} mm, and the 95 % interval covers "
        f"{100 * none['tip_in_95']:.0f} % of the tips."
    )


def _describe_gains(result: Run) -> str:
    """Return by how much the old posterior reduces the error after the first insertions."""
    gains = [row for row in _select_rows(result, "gains", metric="te_mm", baseline="new") if row["n"]]
    parts = [
        f"{row['difference']:+z.3f} mm after {row['n']} (95 % CI {row['low']:+z.3f} to {row['high']:+z.3f})"
        for row in gains[:3]
    ]
    return (
        "Reduction of the TE by the widened posterior, against new insertions alone: "
        + ", ".join(parts).replace("-", "−")
        + "."
    )


def _describe_coverage(result: Run) -> str:
    rows = _select_rows(result, "adaptation", method="inflated")
    shares = [f"{100 * row['tip_in_95']:.0f} % after {row['n']}" for row in rows]
    before, after = (format_mm(row["tip_crps_mm"], 3) for row in (rows[0], rows[-1]))
    return (
        f"With the widened posterior, the 95 % interval covers the tips in {', '.join(shares)} insertions; "
        f"the CRPS of the tip changes from {before} to {after} mm."
    )


def _describe_limits(result: Run) -> str:
    record = _record(result)
    orders = result.frames["orders"]["order"].nunique()
    return (
        f"All errors are of the same {len(record.new.held_out)} held-out insertions, for {orders} random "
        "orders of the others. Brackets: 95 % bootstrap intervals over orders and held-out insertions. With "
        "so few of them the intervals are too narrow; they do not include other specimens. Errors are those "
        "of the posterior mode along the planned path."
    )


def _lay_out_curves(result: Run) -> TableLayout:
    metrics = [metric.name for metric in list_length_metrics()]
    rows = [
        {**row, **_describe_errors(row, name), "method": APPROACH_NAMES[row["method"]]}
        for row in to_records(result.frames["adaptation"])
        if row["method"] != "none" or not row["n"]
        for name in metrics
    ]
    columns = (
        *("method", "n", "groups"),
        *(part(key, metric=name) for name in metrics for key in ("value", "order_range")),
        *("tip_crps_mm", "tip_in_50", "tip_in_95", "pareto_k"),
    )
    floors = to_records(result.frames["adaptation"])[0]
    noise = ", ".join(
        f"{metric.label} {format_mm(floors[f'floor_{metric.name}'], 3)}" for metric in list_length_metrics()
    )
    notes = (
        "n: new insertions that were fitted. Means over the held-out insertions, then over orders; “range” "
        f"is over orders. Noise floor: {noise} mm. “Fits”: number of different sets of insertions. “Pareto "
        "k”: the largest of the importance weights; above 0.7 the posterior was sampled instead.",
    )
    caption = "Errors on held-out insertions against the number n of new insertions fitted."
    curves = pivot(rows, ["method", "n"], ["metric"])
    return Table("adaptation", caption, curves, columns, groups=("method",), heads=1, notes=notes).lay_out()


def _describe_errors(row: Row, metric: str) -> Row:
    low, high = (row[metric.replace("_mm", f"_{end}_mm")] for end in ("min", "max"))
    alike = format_mm(low, 3) == format_mm(high, 3)
    return {"metric": metric, "value": row[metric], "low": None if alike else low, "high": high, DIGITS: 3}


def _lay_out_insertions_needed(result: Run) -> TableLayout:
    rows = [
        {
            **row,
            "target": _TARGETS[row["target"]],
            "method": APPROACH_NAMES[row["method"]],
            "insertions_needed": _format_short_count(row),
            DIGITS: 3,
        }
        for name in ("new", *APPROACH_NAMES)  # the first states value and limit
        for row in _select_rows(result, "insertions_needed", method=name)
    ]
    counts = (part("insertions_needed", method=name) for name in APPROACH_NAMES.values())
    columns = ("metric", "target", "value", "limit_mm", *counts)
    notes = (
        "The smallest number of new insertions from which on the mean error stays at or below the limit. "
        "Brackets: 95 % bootstrap interval over orders and held-out insertions.",
    )
    caption = "Number of insertions that a new specimen needs."
    needed = pivot(rows, ["metric", "target"], ["method"])
    return Table("insertions_needed", caption, needed, columns, groups=("metric",), notes=notes).lay_out()


def _format_short_count(row: Row) -> str:
    low, high = ("∞" if row[end] is None else f"{row[end]:.0f}" for end in ("low", "high"))
    if row["n"] is None and low == high:
        return "not reached"
    count = "not reached" if row["n"] is None else f"{row['n']:.0f}"
    return count if low == high else f"{count} ({low}–{high})"


def draw_figures(result: Run, folder: Path) -> dict[str, Path]:
    """Draw the learning curves; the frame `adaptation` contains the drawn values."""
    if result.frames["adaptation"].empty:
        return {}
    return {"adaptation": draw_curves(result, folder / "adaptation.pdf")}


def compose_sections(result: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: curves, counts, and the inputs of the analysis."""
    curves, counts = lay_out_tables(result)
    caption = (
        "Errors on the held-out insertions against the number of new insertions fitted. Lines: means over "
        "insertions and orders; bands: range over orders. Below: continuous ranked probability score (CRPS) "
        "of the tip, and coverage of the 95 % interval of the tip."
    )
    drawn = [document.figure(figures["adaptation"], caption)] if figures else []
    between = _record(result).between_media
    return [
        document.heading("Adaptation"),
        *drawn,
        document.table(counts),
        document.table(curves),
        document.heading("Assumptions"),
        document.text(
            f"Standard deviations between media: {between.ln_mu_sd:g} in ln μ and {between.ln_bevel_sd:g} "
            f"in ln b (or ln θ). Source: {between.source}. Old and new medium are two draws of one "
            "population, so the covariance of the old posterior is widened by twice their squares; its mode "
            "stays. New layers that the old medium ties together may differ."
        ),
    ]


REPORT = StudyReport(summarize, lay_out_tables, draw_figures, compose_sections)
