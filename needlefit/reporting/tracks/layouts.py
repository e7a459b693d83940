"""The tables of a study of tip tracks."""

from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.names import METHOD_NAMES, medium_name
from needlefit.reporting.numbers import fixed, number, symbol, typeset
from needlefit.reporting.tables import Row, records
from needlefit.validation.tracks.results import (
    METHODS,
    TrackResults,
    compare_methods_by_run,
    tabulate_by_depth,
    tabulate_coverage,
)

NAMES = {**METHOD_NAMES, "constant_curvature": "parabola"}
SHOWN = ("rms_mm", "aligned_rms_mm")
"""Of `summary.MEASURES`, what the table of scores shows."""

_LEARNED = (
    "Percentiles of the posterior. “Left” is its deviation over that of prior and bounds, in ln: where it "
    "is near 1, the percentiles repeat what was put in.",
    "Moduli are for the needle that the dataset assumes: μ / EI is what the runs speak of.",
)
_SCORES = (
    "“Error”: root mean square over the scored readings of the median foretold, mean over runs. Each run "
    "lies in the tracker’s frame as its own readings up to {placed:g} mm, and the slopes of the runs fitted "
    "to, say it does, for all rivals alike.",
    "“Shape”: what remains when the best shift and slope of the scored readings themselves are taken off, "
    "which forgives the frame, and whatever is straight.",
    "Δ is the method’s minus the fit’s; in brackets its 95 % interval over runs (Student). Runs into one "
    "phantom share a fit: the interval is for further runs into it.",
)
_HELD = (
    "Last readings within the interval foretold for them, and tracks of which no scored reading left the "
    "band foretold for them as a whole. In brackets the 95 % interval of the share (Wilson), of runs; over "
    "all, of phantoms as trials, which is next to nothing where they are few.",
)


def parameters_layout(results: TrackResults) -> Display:
    """Return what the runs fitted to say of each parameter."""
    rows = tuple(
        (
            *(str(row["fit"]), symbol(row["parameter"])),
            *(typeset(number(row[at])) for at in ("p2_5", "p50", "p97_5")),
            *(fixed(row["sd_ratio"]), "determined" if row["determined"] else "not determined"),
        )
        for row in records(results.parameters)
    )
    columns = (
        *(text("Fit"), text("Parameter"), Column("2.5 %"), Column("50 %"), Column("97.5 %")),
        *(Column("Left"), text("Verdict")),
    )
    return Display("parameters", "What the runs fitted to tell.", columns, rows, notes=_LEARNED)


def scores_layout(results: TrackResults) -> Display:
    """Return how every method foretold the same runs."""
    rows = []
    for medium, group in compare_methods_by_run(results).groupby("medium", sort=False):
        for method in METHODS:
            by = {str(row["measure"]): row for row in records(group[group["method"] == method])}
            head = (medium_name(str(medium)), str(by[SHOWN[0]]["runs"]), NAMES[method])
            rows.append((*head, *(cell for one in SHOWN for cell in _gap(by[one], method == "fitted"))))
    columns = (
        *(text("Foretold"), Column("Runs"), text("By")),
        *(Column("Error", "mm"), Column("Δ", "mm"), Column("Fit better", "on")),
        *(Column("Shape", "mm"), Column("Δ", "mm"), Column("Fit better", "on")),
    )
    strong = tuple(range(0, len(rows), len(METHODS)))
    notes = (_SCORES[0].format(placed=results.record.registration_depth_mm), *_SCORES[1:])
    return Display("scores", "Runs foretold.", columns, tuple(rows), strong[1:], strong, notes)


def depths_layout(results: TrackResults) -> Display:
    """Return how the errors of what was foretold grow with depth."""
    table = tabulate_by_depth(results)
    stretches = sorted(set(zip(table["from_mm"], table["to_mm"], strict=True)))
    rows = []
    for medium, group in table.groupby("medium", sort=False):
        for method in METHODS:
            of = group[group["method"] == method]
            known = dict(zip(of["from_mm"], of["error_mm"], strict=True))
            cells = (fixed(known.get(low)) for low, _ in stretches)
            rows.append((medium_name(str(medium)), NAMES[method], *cells))
    columns = (text("Foretold"), text("By"), *(Column(f"{low:g}–{high:g}", "mm") for low, high in stretches))
    strong = tuple(range(0, len(rows), len(METHODS)))
    caption = "Mean size of the error of the medians foretold, by depth."
    return Display("depths", caption, columns, tuple(rows), strong[1:], strong)


def coverage_layout(results: TrackResults) -> Display:
    """Return how often what was foretold held: last readings and whole tracks, a run one trial."""
    rows = []
    for (medium, method), group in tabulate_coverage(results).groupby(["medium", "method"], sort=False):
        by = {(row["quantity"], row["level"]): row for row in records(group)}
        shares = tuple(_share(by[what, level]) for what in ("end", "track") for level in (50, 95))
        rows.append((medium_name(str(medium)), NAMES[str(method)], *shares))
    columns = (
        *(text("Foretold"), text("By")),
        *(Column(f"{what} in", f"{level} %") for what in ("Ends", "Tracks") for level in (50, 95)),
    )
    strong = tuple(range(0, len(rows), len(METHODS)))
    return Display("coverage", "How often it held.", columns, tuple(rows), strong[1:], strong, _HELD)


def _gap(row: Row, own: bool) -> tuple[str, str, str]:
    if own:
        return fixed(row["mean_mm"]), "", ""
    low, high = (fixed(row[f"difference_{end}_mm"]) for end in ("low", "high"))
    gap = f"{fixed(row['difference_mm'])} ({low} to {high})".replace("-", "−")
    return fixed(row["mean_mm"]), gap, f"{row['better']} of {row['runs']}"


def _share(row: Row) -> str:
    return f"{row['covered']} of {row['runs']} ({100 * row['low']:.0f}–{100 * row['high']:.0f} %)"
