"""Report of the next insertion: expected information gain of each candidate."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.inference.identifiability.information import describe_precision, short_name
from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting import document
from needlefit.reporting.analyses.page import AnalysisPage, FigurePaths
from needlefit.reporting.document import Block
from needlefit.reporting.figures.style import (
    TEXT_WIDTH_IN,
    draw_grid,
    is_synthetic,
    label_origin,
    plot,
    separate_positions,
)
from needlefit.reporting.labels import GREY, INK, entry_name
from needlefit.reporting.number_format import format_mm, format_symbol, insert_symbols
from needlefit.reporting.table_layout import TableColumn, TableLayout, text_column
from needlefit.reporting.tables import Row, to_records
from needlefit.validation.analyses.planning.next_insertion import LEAST_KNOWN, ROUGH_NOTE
from needlefit.validation.analyses.runner import AnalysisResult

ENTRY_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
LABEL_SPACE = 1.62
"""Width of a panel over its greatest depth; the labels are in the space beyond."""


def draw_gains(result: AnalysisResult, path: Path) -> Path:
    """Draw the expected gain, and the remaining standard deviation of the first predicted tip."""
    return plot(path, result.frames["gains"].assign(origin=result.origin), _paint_gains)


def _paint_gains(gains: pd.DataFrame) -> Figure:
    tip = gains["tip"].dropna().unique()
    figure = Figure(figsize=(TEXT_WIDTH_IN, 2.9))
    panels = figure.subplots(1, 1 + len(tip), squeeze=False)[0]
    _paint_lines(panels[0], gains, "nats")
    panels[0].set_title("Expected gain about all parameters (nats)", loc="left")
    if len(tip):
        now = float(gains["sd_now_mm"].iloc[0])
        panels[1].axhline(now, xmax=1 / LABEL_SPACE, color=INK, lw=0.7, ls=(0, (4, 3)))
        panels[1].text(0.5, now, "now", fontsize=6.5, color=INK, va="bottom")
        _paint_lines(panels[1], gains, "sd_after_mm")
        panels[1].set_title(f"Expected sd of the {tip[0]} (mm)", loc="left")
    for axes in panels:
        axes.set_xlabel("depth (mm)", x=0.5 / LABEL_SPACE)
        draw_grid(axes, "y")
    label_origin(figure, is_synthetic(gains))
    return figure


def _paint_lines(axes: Axes, gains: pd.DataFrame, column: str) -> None:
    """Draw one column against depth, each line named at its end."""
    ends: list[tuple[float, float, str, str]] = []
    candidates = gains[gains["role"] == "candidate"]
    for place, ((entry, angle), rows) in enumerate(candidates.groupby(["entry", "angle_deg"], sort=False)):
        colour = ENTRY_COLOURS[place % len(ENTRY_COLOURS)]
        known = rows[rows[column].notna()]
        if known.empty:
            continue
        x, y = (known[name].to_numpy(dtype=np.float64) for name in ("depth_mm", column))
        if column == "nats":
            spread = known["nats_se"].to_numpy(dtype=np.float64)
            axes.fill_between(x, y - spread, y + spread, color=colour, alpha=0.15, lw=0)
        axes.plot(x, y, color=colour, lw=1.2, marker="o", ms=2.2)
        ends.append((float(y[-1]), float(x[-1]), entry_name(str(entry), float(str(angle))), colour))
    again = gains[(gains["role"] == "repeat") & gains[column].notna()]
    for x, y in zip(again["depth_mm"], again[column], strict=True):
        axes.plot(x, y, "D", ms=4.5, color=INK, mfc="white", zorder=4)
        ends.append((float(y), float(x), "once more", INK))
    _label_ends(axes, sorted(ends), float(gains["depth_mm"].max()))


def _label_ends(axes: Axes, ends: list[tuple[float, float, str, str]], deepest: float) -> None:
    """Write names beyond the lines, in the order of their ends, with a hair to each."""
    bottom, top = 0.0, 1.05 * max(axes.get_ylim()[1], 1e-9)
    gap = 0.062 * (top - bottom)
    at = separate_positions([y for y, *_ in ends], gap * np.arange(len(ends), dtype=np.float64))
    at = at - max(0.0, float(at[-1]) - (top - 0.4 * gap))
    for (y, x, name, colour), place in zip(ends, at.tolist(), strict=True):
        axes.plot([x, 1.06 * deepest], [y, place], color=GREY, lw=0.4, alpha=0.7, zorder=1)
        axes.text(1.08 * deepest, place, name, va="center", color=colour, fontsize=6.5)
    axes.set(xlim=(0, LABEL_SPACE * deepest), ylim=(bottom, top))
    axes.set_xticks([tick for tick in axes.get_xticks() if tick <= deepest])


_CANDIDATE_KEYS = ["role", "entry", "angle_deg", "depth_mm"]


def find_best_candidate(result: AnalysisResult) -> Row | None:
    """Return the candidate with the largest expected information gain; None if none has a solution."""
    ranked = [row for rows in group_candidates(result).values() for row in rows]
    return max(ranked, key=lambda row: float(row["nats"]), default=None)


def find_repeat(result: AnalysisResult) -> Row | None:
    """Return the candidate that repeats the deepest insertion so far; None if it has no solution."""
    every = result.frames["candidates"]
    found = to_records(every[(every["role"] == "repeat") & every["nats"].notna()])
    return found[0] if found else None


def group_candidates(result: AnalysisResult) -> dict[tuple[str, float], list[Row]]:
    """Return the candidates with a solution, grouped by entry and angle."""
    every = result.frames["candidates"]
    found: dict[tuple[str, float], list[Row]] = {}
    for row in to_records(every[(every["role"] == "candidate") & every["nats"].notna()]):
        found.setdefault((str(row["entry"]), float(row["angle_deg"])), []).append(row)
    return found


def select_candidate(frame: pd.DataFrame, where: Row) -> pd.DataFrame:
    """Return the table rows of one candidate."""
    same = np.all([frame[key] == where[key] for key in _CANDIDATE_KEYS], axis=0)
    return frame[same]


BENT_RIDGE_NATS = 0.3
"""Nats by which a linear gain must be too large for the ridge to be called bent: several standard errors."""


def summarize(result: AnalysisResult) -> list[str]:
    """Return sentences: the best candidate, its gain beside that of a repeat, and parameters that no
    candidate determines.
    """
    best, again = find_best_candidate(result), find_repeat(result)
    if best is None:
        return ["No candidate has a solution within the medium."]
    layers = f"layer{'s' if '-' in best['layers'] else ''} {best['layers']}"
    repeated = ""
    if again is not None:
        where = f"{again['entry']}, {again['depth_mm']:.1f} mm"
        repeated = f" Once more the deepest insertion so far ({where}) would tell {_format_nats(again)} nats."
    return [
        f"Most is told by an insertion {_name_entry(best)}, {best['depth_mm']:g} mm deep, through {layers}: "
        f"{_format_nats(best)} nats about all parameters together are expected.{repeated}",
        _describe_parameters(result, best),
        *(_describe_tip(result, str(name)) for name in result.frames["tips"]["tip"].unique()),
        *_describe_alphas(result),
        _describe_agreement(result),
    ]


def _describe_parameters(result: AnalysisResult, best: Row) -> str:
    parts = []
    for row in to_records(select_candidate(result.frames["parameters"], best)):
        name = str(row["parameter"])
        now, after = (_format_precision(name, row[key]) for key in ("sd_now", "sd_after"))
        label = format_symbol(name).split(" (")[0]
        if name == LEAST_KNOWN:
            label = f"the combination known worst, {insert_symbols(str(row['combination']))},"
        parts.append(f"{label} {after} (now {now})")
    return f"What would then be known: {'; '.join(parts)}."


def _format_precision(name: str, sd: float) -> str:
    return describe_precision(sd, name == LEAST_KNOWN or is_logarithmic(name))


def _describe_tip(result: AnalysisResult, name: str) -> str:
    """Return the candidate that reduces the uncertainty of a tip most."""
    every = result.frames["tips"]
    mine = every[(every["tip"] == name) & (every["role"] == "candidate")]
    row = to_records(mine.sort_values("sd_after_mm", kind="stable"))[0]
    return (
        f"Most about the {name} is told {_name_entry(row)}, {row['depth_mm']:g} mm deep: its deviation falls "
        f"from "
        f"{format_mm(row['sd_now_mm'])} to {format_mm(row['sd_after_mm'])} mm."
    )


def _describe_alphas(result: AnalysisResult) -> list[str]:
    every = result.frames["alphas"]
    if every.empty:
        return []
    sd_ratio = float((every["sd_after"] / every["sd_before"]).min())
    names = " and ".join(format_symbol(str(name)) for name in every["parameter"].unique())
    return [
        f"No candidate tells {names}: even with all else known, the deviation of a flat prior between −3 and "
        f"5 would stay {100 * sd_ratio:.1f} % of what it is."
    ]


def _describe_agreement(result: AnalysisResult) -> str:
    row = to_records(result.frames["agreement"])[0]
    if row["spearman"] is None:
        return "There are too few candidates to compare the linear gain with."
    first = "the same candidate" if row["same_best"] else "another candidate"
    excess = float(row["largest_excess_nats"])
    bent = ", for one covariance makes a bent ridge too thick" if excess > BENT_RIDGE_NATS else ""
    return (
        f"Linearised (Σ of the draws, J at each), {first} is first and the rank correlation over "
        f"{row['candidates']} candidates is {row['spearman']:.2f}; the linear gain is up to {excess:.1f} "
        f"nats larger{bent}."
    )


def lay_out_tables(result: AnalysisResult) -> list[TableLayout]:
    """Return the best depth of every entry and angle beside a repeat, and the standard deviations left by the
    best.
    """
    return [_lay_out_ranking(result), _lay_out_expected_sds(result)]


def _lay_out_ranking(result: AnalysisResult) -> TableLayout:
    again, tips = find_repeat(result), result.frames["tips"]
    best_of_entries = [
        max(rows, key=lambda row: float(row["nats"])) for rows in group_candidates(result).values()
    ]
    shown = sorted(best_of_entries, key=lambda row: -float(row["nats"])) + (
        [again] if again is not None else []
    )
    names = [str(name) for name in tips["tip"].unique()]
    columns = (
        *(
            text_column("Entry", wide=True),
            text_column("Layers"),
            TableColumn("Depth", "mm"),
            TableColumn("Tip", "mm"),
        ),
        *(
            TableColumn("Gain", "nats"),
            TableColumn("Linearised", "nats"),
            TableColumn("sd, worst known", "ln"),
        ),
        *(TableColumn(f"sd, {name}", "mm") for name in names),
    )
    now = [
        f"{format_mm(_first_value(tips[tips['tip'] == name], 'sd_now_mm'))} mm of the {name}"
        for name in names
    ]
    known = result.frames["parameters"]
    worst = (
        f"{format_mm(_first_value(known[known['parameter'] == LEAST_KNOWN], 'sd_now'))} of the combination "
        f"known worst"
    )
    note = (
        "The depth at which each way in tells most. Gain: expected fall of entropy, ± its standard error; "
        f"deviations are those expected afterwards; now they are {' and '.join([worst, *now])}. All "
        "candidates are in candidates.csv, parameters.csv and tips.csv."
    )
    caption = "What one more insertion is expected to tell."
    rows = tuple(_candidate_cells(result, row) for row in shown)
    return TableLayout("next_insertion", caption, columns, rows, strong=(0,), notes=(note,))


def _candidate_cells(result: AnalysisResult, row: Row) -> tuple[str, ...]:
    known = select_candidate(result.frames["parameters"], row)
    worst = _first_value(known[known["parameter"] == LEAST_KNOWN], "sd_after")
    ends = (format_mm(float(sd)) for sd in select_candidate(result.frames["tips"], row)["sd_after_mm"])
    entry = "once more" if row["role"] == "repeat" else _name_entry(row)
    mark = f" ({row['note']})" if row["note"] else ""
    where = (entry, str(row["layers"]), f"{row['depth_mm']:.3g}", format_mm(row["tip_mm"]))
    return (*where, _format_nats(row), format_mm(row["linear_nats"]), f"{format_mm(worst)}{mark}", *ends)


def _lay_out_expected_sds(result: AnalysisResult) -> TableLayout:
    """Return how well parameters are known now, and would be."""
    found = [one for one in (find_best_candidate(result), find_repeat(result)) if one is not None]
    each = [to_records(select_candidate(result.frames["parameters"], one)) for one in found]
    rows = []
    for same in zip(*each, strict=True):
        name = str(same[0]["parameter"])
        label = str(same[0]["combination"]) if name == LEAST_KNOWN else short_name(name)
        after = (_format_precision(name, row["sd_after"]) for row in same)
        rows.append((insert_symbols(label), _format_precision(name, same[0]["sd_now"]), *after))
    heads = ("Known now", "After the best", "After a repeat")[: 1 + len(found)]
    columns = (text_column("What"), *(text_column(head) for head in heads))
    return TableLayout("expected_sds", "How well parameters would be known.", columns, tuple(rows))


def draw_figures(result: AnalysisResult, folder: Path) -> dict[str, Path]:
    """Draw the gain of every candidate, if any has a solution."""
    return {} if find_best_candidate(result) is None else {"gains": draw_gains(result, folder / "gains.pdf")}


def compose_sections(result: AnalysisResult, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: figure, tables, and the basis of the numbers."""
    caption = (
        "Expected gain of one more insertion (with its standard error), and the deviation of the tip asked "
        "for that it is expected to leave, against its depth. Diamond: the deepest insertion so far again."
    )
    drawn = [document.figure(path, caption, result.synthetic) for path in figures.values()]
    tables = [document.table(table, result.synthetic) for table in lay_out_tables(result)] if figures else []
    behind = [
        document.text(_describe_posterior(row, result)) for row in to_records(result.frames["posterior"])
    ]
    return [document.heading("What each would tell"), *drawn, *tables, document.heading("How"), *behind]


def _describe_posterior(row: Row, result: AnalysisResult) -> str:
    rough = int((result.frames["candidates"]["note"] == ROUGH_NOTE).sum())
    source = "sampled" if row["sampled"] else f"importance-weighted (Pareto k {row['pareto_k']:.2f})"
    made = f"{row['insertions']} insertion{'s' if row['insertions'] > 1 else ''}"
    marked = f" {rough} candidates leave so few draws that deviations are rough (marked)." if rough else ""
    return (
        f"The posterior of the {made} made so far is {source}: {row['draws']} draws, worth "
        f"{row['ess']:.0f} independent ones. Some of them predict data, with errors of pose, depths "
        "and points as in the dataset, and all are reweighted by these data (nested Monte Carlo): the mean "
        "fall of entropy is the gain, and the new weights give the deviations. A gain of 1 nat divides the "
        f"volume of what is possible by 2.7.{marked} What the model misses is not in it: an insertion that "
        "checks the model may be worth more than one that narrows its parameters."
    )


def _first_value(frame: pd.DataFrame, column: str) -> float:
    return float(frame[column].to_numpy(dtype=np.float64)[0])


def _name_entry(row: Row) -> str:
    return entry_name(str(row["entry"]), float(row["angle_deg"]))


def _format_nats(row: Row) -> str:
    return f"{row['nats']:.2f} ± {row['nats_se']:.2f}"


PAGE = AnalysisPage(summarize, lay_out_tables, draw_figures, compose_sections)
