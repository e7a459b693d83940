"""Report of the next insertion: expected information gain of each candidate."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.inference.identifiability.precision import describe_precision, format_sd, short_name
from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.figures.style import (
    TEXT_WIDTH_IN,
    draw_grid,
    plot,
    separate_positions,
)
from needlefit.reporting.labels import GREY, INK, entry_name
from needlefit.reporting.number_format import format_bare_symbol, format_mm, format_symbol, insert_symbols
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.kinds.next_insertion.run import LEAST_KNOWN, ROUGH_NOTE
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run

ENTRY_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
LABEL_SPACE = 1.62
"""Width of a panel over its greatest depth; the labels are in the space beyond."""


def draw_gains(result: Run, path: Path) -> Path:
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
        panels[1].set_title(f"Expected SD of the {tip[0]} (mm)", loc="left")
    for axes in panels:
        axes.set_xlabel("depth (mm)", x=0.5 / LABEL_SPACE)
        draw_grid(axes, "y")
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
        ends.append((float(y), float(x), "repeat", INK))
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


def find_best_candidate(result: Run) -> Row | None:
    """Return the candidate with the largest expected information gain; None if none has a solution."""
    ranked = [row for rows in group_candidates(result).values() for row in rows]
    return max(ranked, key=lambda row: float(row["nats"]), default=None)


def find_repeat(result: Run) -> Row | None:
    """Return the candidate that repeats the deepest insertion so far; None if it has no solution."""
    every = result.frames["candidates"]
    found = to_records(every[(every["role"] == "repeat") & every["nats"].notna()])
    return found[0] if found else None


def group_candidates(result: Run) -> dict[tuple[str, float], list[Row]]:
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
"""Excess of a linear gain (nats) above which the ridge is called curved: several standard errors."""


def summarize(result: Run) -> list[str]:
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
        repeated = f" (repeat of the deepest insertion so far, {where}: {_format_nats(again)} nats)"
    return [
        f"Best next insertion: {_name_entry(best)}, {best['depth_mm']:g} mm deep, through {layers}; expected "
        f"information gain {_format_nats(best)} nats{repeated}.",
        _describe_parameters(result, best),
        *(_describe_tip(result, str(name)) for name in result.frames["tips"]["tip"].unique()),
        *_describe_alphas(result),
        _describe_agreement(result),
    ]


def _describe_parameters(result: Run, best: Row) -> str:
    parts = []
    for row in to_records(select_candidate(result.frames["parameters"], best)):
        name = str(row["parameter"])
        now, after = (_format_precision(name, row[key]) for key in ("sd_now", "sd_after"))
        label = format_bare_symbol(name)
        if name == LEAST_KNOWN:
            label = f"worst-determined combination, {insert_symbols(str(row['combination']))},"
        parts.append(f"{label} {after} (now {now})")
    return f"Expected posterior SD after it: {'; '.join(parts)}."


def _format_precision(name: str, sd: float) -> str:
    return describe_precision(sd, name == LEAST_KNOWN or is_logarithmic(name))


def _describe_tip(result: Run, name: str) -> str:
    """Return the candidate that reduces the uncertainty of a tip most."""
    every = result.frames["tips"]
    mine = every[(every["tip"] == name) & (every["role"] == "candidate")]
    row = to_records(mine.sort_values("sd_after_mm", kind="stable"))[0]
    return (
        f"Best insertion to predict the {name}: {_name_entry(row)}, {row['depth_mm']:g} mm deep; the "
        f"expected SD falls from {format_mm(row['sd_now_mm'])} to {format_mm(row['sd_after_mm'])} mm."
    )


def _describe_alphas(result: Run) -> list[str]:
    every = result.frames["alphas"]
    if every.empty:
        return []
    sd_ratio = float((every["sd_after"] / every["sd_now"]).min())
    names = " and ".join(format_symbol(str(name)) for name in every["parameter"].unique())
    return [
        f"No candidate identifies {names}: with all else known, the posterior SD would still be "
        f"{100 * sd_ratio:.1f} % of that of a flat prior within the usual bounds."
    ]


def _describe_agreement(result: Run) -> str:
    row = to_records(result.frames["agreement"])[0]
    if row["spearman"] is None:
        return "There are too few candidates for a comparison with the linearised gain."
    first = "the same candidate" if row["same_best"] else "another candidate"
    excess = float(row["largest_excess_nats"])
    bent = ", because one covariance overestimates a curved ridge" if excess > BENT_RIDGE_NATS else ""
    return (
        f"The linearised gain (covariance of the draws, Jacobian at each) ranks {first} first. Its rank "
        f"correlation over {row['candidates']} candidates is {row['spearman']:.2f}; it is up to "
        f"{excess:.1f} nats larger{bent}."
    )


def lay_out_tables(result: Run) -> list[TableLayout]:
    """Return the best depth of every entry and angle beside a repeat, and the standard deviations left by the
    best.
    """
    return [_lay_out_ranking(result), _lay_out_expected_sds(result)]


def _lay_out_ranking(result: Run) -> TableLayout:
    again, tips = find_repeat(result), result.frames["tips"]
    best_of_entries = [
        max(rows, key=lambda row: float(row["nats"])) for rows in group_candidates(result).values()
    ]
    shown = sorted(best_of_entries, key=lambda row: -float(row["nats"])) + (
        [again] if again is not None else []
    )
    names = [str(name) for name in tips["tip"].unique()]
    columns = (
        *("entry", "layers_passed", "candidate_depth_mm", "deflection_mm", "gain", "linear_nats"),
        *("worst_known_sd", *(part("sd_after_mm", tip=name) for name in names)),
    )
    now = [
        f"{format_mm(_first_value(tips[tips['tip'] == name], 'sd_now_mm'))} mm of the {name}"
        for name in names
    ]
    known = result.frames["parameters"]
    worst = (
        f"{format_sd(_first_value(known[known['parameter'] == LEAST_KNOWN], 'sd_now'), True)} of the "
        "worst-determined combination"
    )
    note = (
        "The best depth for each entry. Gain: expected decrease of entropy ± standard error. SD: expected "
        f"after the insertion; now it is {' and '.join([worst, *now])}. All candidates are in "
        "candidates.csv, parameters.csv and tips.csv."
    )
    caption = "Expected information gain of one more insertion."
    tips_of_shown = [one for number, row in enumerate(shown) for one in _describe_tips(result, row, number)]
    rows = pivot(tips_of_shown, ["number"], ["tip"])
    return Table("next_insertion", caption, rows, columns, strong="first", notes=(note,)).lay_out()


def _describe_tips(result: Run, row: Row, number: int) -> list[Row]:
    """Return a row per tip: what is printed of a candidate, and of the tip after it."""
    known = select_candidate(result.frames["parameters"], row)
    about = {
        "entry": "repeat of the deepest" if row["role"] == "repeat" else _name_entry(row),
        "layers_passed": row["layers"],
        "candidate_depth_mm": row["depth_mm"],
        "sd_after": format_sd(_first_value(known[known["parameter"] == LEAST_KNOWN], "sd_after"), True),
        "number": number,
    }
    tips = to_records(select_candidate(result.frames["tips"], row))
    return [{**row, **about, "tip": one["tip"], "sd_after_mm": one["sd_after_mm"]} for one in tips]


def _lay_out_expected_sds(result: Run) -> TableLayout:
    """Return how well parameters are known now, and would be."""
    found = [one for one in (find_best_candidate(result), find_repeat(result)) if one is not None]
    each = [to_records(select_candidate(result.frames["parameters"], one)) for one in found]
    keys = ("known_now", "known_after_best", "known_after_repeat")[: 1 + len(found)]
    rows = []
    for same in zip(*each, strict=True):
        name = str(same[0]["parameter"])
        label = str(same[0]["combination"]) if name == LEAST_KNOWN else short_name(name)
        sds = (same[0]["sd_now"], *(row["sd_after"] for row in same))
        known = zip(keys, (_format_precision(name, sd) for sd in sds), strict=True)
        rows.append({"known_quantity": insert_symbols(label), **dict(known)})
    caption = "Posterior SD of the parameters: now, and expected after a further insertion."
    return Table("expected_sds", caption, rows, ("known_quantity", *keys)).lay_out()


def draw_figures(result: Run, folder: Path) -> dict[str, Path]:
    """Draw the gain of every candidate, if any has a solution."""
    return {} if find_best_candidate(result) is None else {"gains": draw_gains(result, folder / "gains.pdf")}


def compose_sections(result: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: figure, tables, and the basis of the numbers."""
    caption = (
        "Expected information gain of one more insertion (band: standard error), and expected SD of the "
        "predicted tip after it, against its depth. Diamond: repeat of the deepest insertion so far."
    )
    drawn = [document.figure(path, caption) for path in figures.values()]
    tables = [document.table(table) for table in lay_out_tables(result)] if figures else []
    behind = [
        document.text(_describe_posterior(row, result)) for row in to_records(result.frames["posterior"])
    ]
    return [document.heading("Candidates"), *drawn, *tables, document.heading("Method"), *behind]


def _describe_posterior(row: Row, result: Run) -> str:
    rough = int((result.frames["candidates"]["note"] == ROUGH_NOTE).sum())
    source = "sampled" if row["sampled"] else f"importance-weighted (Pareto k {row['pareto_k']:.2f})"
    made = f"{row['insertions']} insertion{'s' if row['insertions'] > 1 else ''}"
    marked = f" For {rough} candidates few draws remain: their SDs are rough (marked)." if rough else ""
    return (
        f"The posterior of the {made} so far is {source}: {row['draws']} draws with an effective sample size "
        f"of {row['ess']:.0f}. Data of each candidate are simulated from some draws, with errors of pose, "
        "depths and points as in the dataset. All draws are reweighted by these data (nested Monte Carlo): "
        "the mean decrease of entropy is the gain, and the new weights give the SDs. A gain of 1 nat "
        f"divides the posterior volume by 2.7.{marked} Model error is not included: an insertion that tests "
        "the model may be more useful than one that narrows its parameters."
    )


def _first_value(frame: pd.DataFrame, column: str) -> float:
    return float(frame[column].to_numpy(dtype=np.float64)[0])


def _name_entry(row: Row) -> str:
    return entry_name(str(row["entry"]), float(row["angle_deg"]))


def _format_nats(row: Row) -> str:
    return f"{row['nats']:.2f} ± {row['nats_se']:.2f}"


REPORT = StudyReport(summarize, lay_out_tables, draw_figures, compose_sections)
