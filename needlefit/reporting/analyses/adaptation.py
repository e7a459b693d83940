"""Report of an adaptation: how many insertions a new specimen needs."""

from pathlib import Path

from needlefit.reporting import document
from needlefit.reporting.analyses.page import AnalysisPage, FigurePaths
from needlefit.reporting.document import Block
from needlefit.reporting.figures.adaptation import draw_curves
from needlefit.reporting.labels import APPROACH_NAMES, medium_name
from needlefit.reporting.number_format import format_mm
from needlefit.reporting.table_layout import TableColumn, TableLayout, text_column
from needlefit.reporting.tables import Row, to_records
from needlefit.schemas.analyses import AdaptationRecord
from needlefit.validation.analyses.runner import AnalysisResult

_ERRORS = {"te_mm": "tip", "ipe_mean_mm": "in-plane"}
_COUNTS = ("n", "n_low", "n_high")
_TARGETS = {"all": "what all of them give", "floor": "the noise floor"}


def summarize(result: AnalysisResult) -> list[str]:
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


def lay_out_tables(result: AnalysisResult) -> list[TableLayout]:
    """Return the learning curves as a table, with the number of insertions from which errors are small
    enough.
    """
    return [_lay_out_curves(result), _lay_out_insertions_needed(result)]


def _record(result: AnalysisResult) -> AdaptationRecord:
    assert isinstance(result.record, AdaptationRecord)
    return result.record


def _name_new(result: AnalysisResult) -> str:
    """Return what the new insertions went into: the one specimen that is named, or the medium."""
    new = _record(result).new
    named = new.insertions.specimens or ()
    return medium_name(named[0].replace("-", " ") if len(named) == 1 else new.medium)


def _select_rows(result: AnalysisResult, frame: str, **keys: object) -> list[Row]:
    rows = to_records(result.frames[frame])
    return [row for row in rows if all(row[key] == value for key, value in keys.items())]


def _describe_cost(result: AnalysisResult) -> str:
    """Return how many insertions it takes, or that more of them do not pay."""
    by_approach = {
        row["approach"]: row
        for row in _select_rows(result, "insertions_needed", measure="te_mm", target="all")
    }
    record, most = _record(result), int(result.frames["adaptation"]["n"].max())
    every, none = (
        by_approach["new"]["target_mm"],
        _select_rows(result, "adaptation", approach="none")[0]["te_mm"],
    )
    if by_approach["none"]["n"] == 0:
        return (
            f"No insertion into {_name_new(result)} pays: the mean held-out tip error is "
            f"{format_mm(none, 3)} mm without an update and {format_mm(every, 3)} mm after all {most} "
            f"insertions "
            "alone."
        )
    return (
        f"{_name_new(result).capitalize()} costs {_format_count(by_approach['inflated'], most)} where the "
        f"posterior of "
        f"{medium_name(record.old.medium)}, inflated, is updated, and "
        f"{_format_count(by_approach['new'], most)} where new "
        f"insertions stand alone: from there on the mean held-out tip error stays within "
        f"{record.margin_mm:g} mm of the {format_mm(every, 3)} mm that all {most} insertions alone give."
    )


def _describe_floor(result: AnalysisResult) -> str:
    by_approach = {
        row["approach"]: row
        for row in _select_rows(result, "insertions_needed", measure="te_mm", target="floor")
    }
    most = int(result.frames["adaptation"]["n"].max())
    return (
        f"To stay within {_record(result).margin_mm:g} mm of the noise floor "
        f"({format_mm(by_approach['new']['target_mm'], 3)} mm) costs "
        f"{_format_count(by_approach['inflated'], most)} with the old "
        f"posterior, and {_format_count(by_approach['new'], most)} without."
    )


def _format_count(row: Row, most: int) -> str:
    """Return a count of insertions with its interval."""
    n, low, high = (f"more than {most}" if row[end] is None else f"{row[end]:.0f}" for end in _COUNTS)
    count = f"{n} insertion{'' if row['n'] == 1 else 's'}"
    return count if low == high else f"{count} ({low} to {high})"


def _describe_no_update(result: AnalysisResult) -> str:
    none = _select_rows(result, "adaptation", approach="none")[0]
    return (
        f"Without an update that error is {format_mm(none['te_mm'], 3)} mm, and "
        f"{100 * none['tip_in_95']:.0f} % "
        "of the tips are in the 95 % interval predicted for them."
    )


def _describe_gains(result: AnalysisResult) -> str:
    """Return what the old posterior spares after the first insertions."""
    gains = [row for row in _select_rows(result, "gains", measure="te_mm", baseline="new") if row["n"]]
    parts = [
        f"{row['gain_mm']:+.3f} mm after {row['n']} ({row['gain_low_mm']:+.3f} to {row['gain_high_mm']:+.3f})"
        for row in gains[:3]
    ]
    return (
        "What the old posterior takes off the tip error of new insertions alone: "
        + ", ".join(parts).replace("-", "−")
        + "."
    )


def _describe_coverage(result: AnalysisResult) -> str:
    rows = _select_rows(result, "adaptation", approach="inflated")
    shares = [f"{100 * row['tip_in_95']:.0f} % after {row['n']}" for row in rows]
    before, after = (format_mm(row["tip_crps_mm"], 3) for row in (rows[0], rows[-1]))
    return (
        f"By the old posterior, inflated, tips are in their 95 % interval in {', '.join(shares)}; the CRPS "
        f"of the tip goes from {before} to {after} mm."
    )


def _describe_limits(result: AnalysisResult) -> str:
    record = _record(result)
    orders = result.frames["orders"]["order"].nunique()
    return (
        f"All of it is of {len(record.new.held_out)} held-out needles, the same throughout, and {orders} "
        "random orders of the others. Intervals in brackets are of 95 %, over orders and held-out needles "
        "drawn again; with so few of them they are rather too narrow, and other specimens are not in them. "
        "Errors are those of the best fit along the planned path."
    )


def _lay_out_curves(result: AnalysisResult) -> TableLayout:
    columns = (
        *(text_column("Approach"), TableColumn("n"), TableColumn("Fits")),
        *(
            TableColumn("TE", "mm"),
            TableColumn("range", "mm"),
            TableColumn("IPE", "mm"),
            TableColumn("range", "mm"),
        ),
        *(
            TableColumn("Tip CRPS", "mm"),
            TableColumn("Tips in", "50 %"),
            TableColumn("Tips in", "95 %"),
            TableColumn("Pareto k"),
        ),
    )
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    named: set[str] = set()
    for row in to_records(result.frames["adaptation"]):
        if row["approach"] == "none" and row["n"]:
            continue
        new = row["approach"] not in named
        breaks += [len(rows)] if rows and new else []
        rows.append((APPROACH_NAMES[row["approach"]] if new else "", *_curve_cells(row)))
        named.add(row["approach"])
    floors = to_records(result.frames["adaptation"])[0]
    te, ipe = (format_mm(floors[f"floor_{name}"], 3) for name in _ERRORS)
    notes = (
        "n: new insertions learned from. Means over the held-out needles, then over orders; “range” is of "
        f"orders. Noise floor: TE {te}, IPE {ipe} mm. “Fits” counts the different sets of insertions behind "
        "a row, “Pareto k” is the worst of the draws’ weights: above 0.7 the posterior was sampled instead.",
    )
    caption = "Errors on held-out needles against the number of new insertions learned from."
    return TableLayout("adaptation", caption, columns, tuple(rows), tuple(breaks), notes=notes)


def _curve_cells(row: Row) -> tuple[str, ...]:
    def span(name: str) -> str:
        low, high = (format_mm(row[f"{name}_{end}_mm"], 3) for end in ("min", "max"))
        return "" if low == high else f"{low}–{high}"

    shares = (f"{100 * row[f'tip_in_{level}']:.0f} %" for level in (50, 95))
    sets = "" if row["sets"] is None else f"{row['sets']:.0f}"
    scores = (format_mm(row["te_mm"], 3), span("te"), format_mm(row["ipe_mean_mm"], 3), span("ipe_mean"))
    return (
        f"{row['n']}",
        sets,
        *scores,
        format_mm(row["tip_crps_mm"], 3),
        *shares,
        format_mm(row["worst_pareto_k"]),
    )


def _lay_out_insertions_needed(result: AnalysisResult) -> TableLayout:
    columns = (
        *(
            text_column("Error"),
            text_column("Within reach of"),
            TableColumn("Target", "mm"),
            TableColumn("Limit", "mm"),
        ),
        *(TableColumn(APPROACH_NAMES[approach]) for approach in APPROACH_NAMES),
    )
    rows = []
    for measure, words in _ERRORS.items():
        for target, target_words in _TARGETS.items():
            by_approach = {
                row["approach"]: row
                for row in _select_rows(result, "insertions_needed", measure=measure, target=target)
            }
            levels = (
                format_mm(by_approach["new"]["target_mm"], 3),
                format_mm(by_approach["new"]["limit_mm"], 3),
            )
            rows.append(
                (
                    words,
                    target_words,
                    *levels,
                    *(_format_short_count(by_approach[approach]) for approach in APPROACH_NAMES),
                )
            )
    notes = (
        "The smallest number of new insertions from which on the mean error stays at or below the limit; in "
        "brackets its 95 % interval over orders and held-out needles drawn again.",
    )
    caption = "How many insertions a new specimen costs."
    return TableLayout("insertions_needed", caption, columns, tuple(rows), (2,), notes=notes)


def _format_short_count(row: Row) -> str:
    low, high = ("∞" if row[end] is None else f"{row[end]:.0f}" for end in ("n_low", "n_high"))
    if row["n"] is None and low == high:
        return "not reached"
    count = "not reached" if row["n"] is None else f"{row['n']:.0f}"
    return count if low == high else f"{count} ({low}–{high})"


def draw_figures(result: AnalysisResult, folder: Path) -> dict[str, Path]:
    """Draw the learning curves; the frame `adaptation` contains the drawn values."""
    if result.frames["adaptation"].empty:
        return {}
    return {"adaptation": draw_curves(result, folder / "adaptation.pdf")}


def compose_sections(result: AnalysisResult, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: curves, counts, and the inputs of the analysis."""
    curves, counts = lay_out_tables(result)
    caption = (
        "Errors on the held-out needles against the number of new insertions learned from: means over "
        "needles and orders (lines), and the range of orders (bands). Below: the continuous ranked "
        "probability score of the tip, and the part of tips within the 95 % interval predicted for them."
    )
    drawn = [document.figure(figures["adaptation"], caption, result.synthetic)] if figures else []
    between = _record(result).between_media
    return [
        document.heading("Adaptation"),
        *drawn,
        document.table(counts, result.synthetic),
        document.table(curves, result.synthetic),
        document.heading("What was assumed"),
        document.text(
            f"Between media, standard deviations of {between.ln_mu_sd:g} in ln μ and {between.ln_bevel_sd:g} "
            f"in ln b: {between.source}. Old and new medium are taken for two draws of one population, so "
            "that the old posterior is widened by twice the square of these; it peaks at the old fit. New "
            "layers that the old medium ties together may differ."
        ),
    ]


PAGE = AnalysisPage(summarize, lay_out_tables, draw_figures, compose_sections)
