"""What is told of an adaptation: what a new specimen costs."""

from pathlib import Path

from needlefit.reporting import document
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.document import Block
from needlefit.reporting.figures.adaptation import draw_curves
from needlefit.reporting.inquiries.page import Figures, Page
from needlefit.reporting.names import WAY_NAMES, medium_name
from needlefit.reporting.numbers import fixed
from needlefit.reporting.tables import Row, records
from needlefit.schemas.analyses import AdaptationRecord
from needlefit.validation.analyses.runner import AnalysisResult

_ERRORS = {"te_mm": "tip", "ipe_mean_mm": "in-plane"}
_COUNTS = ("n", "n_low", "n_high")
_TARGETS = {"all": "what all of them give", "floor": "the noise floor"}


def said(answer: AnalysisResult) -> list[str]:
    """Return what a new specimen costs, what the old posterior is worth, and what the intervals are of."""
    parts = (_cost, _floor, _without, _worth, _foretold, _limits)
    return [part(answer) for part in parts]


def layouts(answer: AnalysisResult) -> list[Display]:
    """Return the curves as a table, and from where on they are good enough."""
    return [_curves(answer), _reached(answer)]


def _record(answer: AnalysisResult) -> AdaptationRecord:
    assert isinstance(answer.record, AdaptationRecord)
    return answer.record


def _new(answer: AnalysisResult) -> str:
    """Return what the new insertions went into: the one specimen that is named, or the medium."""
    new = _record(answer).new
    named = new.insertions.specimens or ()
    return medium_name(named[0].replace("-", " ") if len(named) == 1 else new.medium)


def _rows(answer: AnalysisResult, frame: str, **keys: object) -> list[Row]:
    rows = records(answer.frames[frame])
    return [row for row in rows if all(row[key] == value for key, value in keys.items())]


def _cost(answer: AnalysisResult) -> str:
    """Return how many insertions it takes, or that more of them do not pay."""
    by = {row["approach"]: row for row in _rows(answer, "insertions_needed", measure="te_mm", target="all")}
    record, most = _record(answer), int(answer.frames["adaptation"]["n"].max())
    every, none = by["new"]["target_mm"], _rows(answer, "adaptation", approach="none")[0]["te_mm"]
    if by["none"]["n"] == 0:
        return (
            f"No insertion into {_new(answer)} pays: the mean held-out tip error is "
            f"{fixed(none, 3)} mm without an update and {fixed(every, 3)} mm after all {most} insertions "
            "alone."
        )
    return (
        f"{_new(answer).capitalize()} costs {_count(by['inflated'], most)} where the posterior of "
        f"{medium_name(record.old.medium)}, inflated, is updated, and {_count(by['new'], most)} where new "
        f"insertions stand alone: from there on the mean held-out tip error stays within "
        f"{record.margin_mm:g} mm of the {fixed(every, 3)} mm that all {most} insertions alone give."
    )


def _floor(answer: AnalysisResult) -> str:
    by = {row["approach"]: row for row in _rows(answer, "insertions_needed", measure="te_mm", target="floor")}
    most = int(answer.frames["adaptation"]["n"].max())
    return (
        f"To stay within {_record(answer).margin_mm:g} mm of the noise floor "
        f"({fixed(by['new']['target_mm'], 3)} mm) costs {_count(by['inflated'], most)} with the old "
        f"posterior, and {_count(by['new'], most)} without."
    )


def _count(row: Row, most: int) -> str:
    """Return a count of insertions with its interval."""
    n, low, high = (f"more than {most}" if row[end] is None else f"{row[end]:.0f}" for end in _COUNTS)
    count = f"{n} insertion{'' if row['n'] == 1 else 's'}"
    return count if low == high else f"{count} ({low} to {high})"


def _without(answer: AnalysisResult) -> str:
    none = _rows(answer, "adaptation", approach="none")[0]
    return (
        f"Without an update that error is {fixed(none['te_mm'], 3)} mm, and {100 * none['tip_in_95']:.0f} % "
        "of the tips are in the 95 % interval foretold for them."
    )


def _worth(answer: AnalysisResult) -> str:
    """Return what the old posterior spares after the first insertions."""
    gains = [row for row in _rows(answer, "gains", measure="te_mm", baseline="new") if row["n"]]
    parts = [
        f"{row['gain_mm']:+.3f} mm after {row['n']} ({row['gain_low_mm']:+.3f} to {row['gain_high_mm']:+.3f})"
        for row in gains[:3]
    ]
    return (
        "What the old posterior takes off the tip error of new insertions alone: "
        + ", ".join(parts).replace("-", "−")
        + "."
    )


def _foretold(answer: AnalysisResult) -> str:
    rows = _rows(answer, "adaptation", approach="inflated")
    shares = [f"{100 * row['tip_in_95']:.0f} % after {row['n']}" for row in rows]
    before, after = (fixed(row["tip_crps_mm"], 3) for row in (rows[0], rows[-1]))
    return (
        f"By the old posterior, inflated, tips are in their 95 % interval in {', '.join(shares)}; the CRPS "
        f"of the tip goes from {before} to {after} mm."
    )


def _limits(answer: AnalysisResult) -> str:
    record = _record(answer)
    orders = answer.frames["orders"]["order"].nunique()
    return (
        f"All of it is of {len(record.new.held_out)} held-out needles, the same throughout, and {orders} "
        "random orders of the others. Intervals in brackets are of 95 %, over orders and held-out needles "
        "drawn again; with so few of them they are rather too narrow, and other specimens are not in them. "
        "Errors are those of the best fit along the planned path."
    )


def _curves(answer: AnalysisResult) -> Display:
    columns = (
        *(text("Way"), Column("n"), Column("Fits")),
        *(Column("TE", "mm"), Column("range", "mm"), Column("IPE", "mm"), Column("range", "mm")),
        *(Column("Tip CRPS", "mm"), Column("Tips in", "50 %"), Column("Tips in", "95 %"), Column("Pareto k")),
    )
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    named: set[str] = set()
    for row in records(answer.frames["adaptation"]):
        if row["approach"] == "none" and row["n"]:
            continue
        new = row["approach"] not in named
        breaks += [len(rows)] if rows and new else []
        rows.append((WAY_NAMES[row["approach"]] if new else "", *_cells(row)))
        named.add(row["approach"])
    floors = records(answer.frames["adaptation"])[0]
    te, ipe = (fixed(floors[f"floor_{name}"], 3) for name in _ERRORS)
    notes = (
        "n: new insertions learned from. Means over the held-out needles, then over orders; “range” is of "
        f"orders. Noise floor: TE {te}, IPE {ipe} mm. “Fits” counts the different sets of insertions behind "
        "a row, “Pareto k” is the worst of the draws’ weights: above 0.7 the posterior was sampled instead.",
    )
    caption = "Errors on held-out needles against the number of new insertions learned from."
    return Display("adaptation", caption, columns, tuple(rows), tuple(breaks), notes=notes)


def _cells(row: Row) -> tuple[str, ...]:
    def span(name: str) -> str:
        low, high = (fixed(row[f"{name}_{end}_mm"], 3) for end in ("min", "max"))
        return "" if low == high else f"{low}–{high}"

    shares = (f"{100 * row[f'tip_in_{level}']:.0f} %" for level in (50, 95))
    sets = "" if row["sets"] is None else f"{row['sets']:.0f}"
    scores = (fixed(row["te_mm"], 3), span("te"), fixed(row["ipe_mean_mm"], 3), span("ipe_mean"))
    return (f"{row['n']}", sets, *scores, fixed(row["tip_crps_mm"], 3), *shares, fixed(row["worst_pareto_k"]))


def _reached(answer: AnalysisResult) -> Display:
    columns = (
        *(text("Error"), text("Within reach of"), Column("Target", "mm"), Column("Limit", "mm")),
        *(Column(WAY_NAMES[approach]) for approach in WAY_NAMES),
    )
    rows = []
    for measure, words in _ERRORS.items():
        for target, said_of in _TARGETS.items():
            by = {
                row["approach"]: row
                for row in _rows(answer, "insertions_needed", measure=measure, target=target)
            }
            levels = (fixed(by["new"]["target_mm"], 3), fixed(by["new"]["limit_mm"], 3))
            rows.append((words, said_of, *levels, *(_short(by[approach]) for approach in WAY_NAMES)))
    notes = (
        "The smallest number of new insertions from which on the mean error stays at or below the limit; in "
        "brackets its 95 % interval over orders and held-out needles drawn again.",
    )
    caption = "How many insertions a new specimen costs."
    return Display("insertions_needed", caption, columns, tuple(rows), (2,), notes=notes)


def _short(row: Row) -> str:
    low, high = ("∞" if row[end] is None else f"{row[end]:.0f}" for end in ("n_low", "n_high"))
    if row["n"] is None and low == high:
        return "not reached"
    count = "not reached" if row["n"] is None else f"{row['n']:.0f}"
    return count if low == high else f"{count} ({low}–{high})"


def draw_figures(answer: AnalysisResult, folder: Path) -> dict[str, Path]:
    """Draw the curves; the frame `adaptation` holds what is drawn."""
    if answer.frames["adaptation"].empty:
        return {}
    return {"adaptation": draw_curves(answer, folder / "adaptation.pdf")}


def story(answer: AnalysisResult, figures: Figures) -> list[Block]:
    """Return curves, counts, and what was put in."""
    curves, counts = layouts(answer)
    caption = (
        "Errors on the held-out needles against the number of new insertions learned from: means over "
        "needles and orders (lines), and the range of orders (bands). Below: the continuous ranked "
        "probability score of the tip, and the part of tips within the 95 % interval foretold for them."
    )
    drawn = [document.figure(figures["adaptation"], caption, answer.synthetic)] if figures else []
    between = _record(answer).between_media
    return [
        document.heading("Adaptation"),
        *drawn,
        document.table(counts, answer.synthetic),
        document.table(curves, answer.synthetic),
        document.heading("What was assumed"),
        document.text(
            f"Between media, standard deviations of {between.ln_mu_sd:g} in ln μ and {between.ln_bevel_sd:g} "
            f"in ln b: {between.source}. Old and new medium are taken for two draws of one population, so "
            "that the old posterior is widened by twice the square of these; it peaks at the old fit. New "
            "layers that the old medium ties together may differ."
        ),
    ]


PAGE = Page(said, layouts, draw_figures, story)
