"""What is told of a plan: how it would go, and by how much it and its rivals would miss."""

from collections.abc import Collection
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from needlefit.project.records.plan import PlanRecord
from needlefit.reporting import document
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.document import Block
from needlefit.reporting.figures.labels import apart
from needlefit.reporting.figures.style import WIDTH, draw, label_origin, light_grid
from needlefit.reporting.inquiries.page import Figures, Page
from needlefit.reporting.names import GREY, INK, RIVAL_COLOURS, SYNTHETIC
from needlefit.reporting.numbers import fixed
from needlefit.reporting.tables import Row, records
from needlefit.validation.inquiries.answer import Answer
from needlefit.validation.inquiries.planning.plan import (
    BEST_FIT,
    EXPECTED,
    HAND_TUNED,
    STRAIGHT,
    TARGET,
    at_bounds,
    reaches,
)

NAMES = {
    EXPECTED: "least expected squared miss",
    BEST_FIT: "best fit, taken for certain",
    HAND_TUNED: "paper's hand-tuned set",
    STRAIGHT: "straight at the target",
}
COLOURS = {
    EXPECTED: RIVAL_COLOURS["fitted"],
    BEST_FIT: "#CC79A7",
    HAND_TUNED: RIVAL_COLOURS["hand_tuned"],
    STRAIGHT: GREY,
}
_SHADES = ("#f7f4ee", "#e2d9c6", "#efeadd", "#d3c7ae", "#e9e2d2")


def said(answer: Answer) -> list[str]:
    """Return the plan, by how much it would miss, and what the others would."""
    rows = {str(row["plan"]): row for row in records(answer.frames["plans"])}
    ours = rows[EXPECTED]
    side = "+" if ours["bevel_side"] > 0 else "−"
    way = f"turned by {_signed(ours['angle_deg'])}°, {ours['depth_mm']:.1f} mm deep, bevel toward {side}y"
    misses = {
        str(row["plan"]): f"{fixed(row['median_mm'])} and {fixed(row['miss_95_mm'])} mm"
        for row in rows.values()
    }
    others = "; ".join(
        f"{NAMES[name]}, {both}{_bounded(answer, rows[name])}"
        for name, both in misses.items()
        if name != EXPECTED
    )
    return [
        f"{_aim_said(answer, ours)}: enter at y = {_signed(ours['offset_mm'])} mm, {way}"
        f"{_bounded(answer, ours)}.",
        f"Tried on {ours['tried']} fresh draws, half and 95 % of the needles miss by at most "
        f"{misses[EXPECTED]}. {_beyond_said(answer)}",
        f"Other plans: {others}.",
    ]


def _aim_said(answer: Answer, ours: Row) -> str:
    """Return what the plan is for, or that there is none, and what stands in its place."""
    (x, y), limit = _record(answer).target_mm, max(_record(answer).tolerances_mm)
    target = f"x = {x:g}, y = {y:g} mm"
    if reaches(ours["median_mm"], limit):
        return f"To bring the tip to {target}"
    return f"No plan within these bounds reaches {target}, to {limit:g} mm. The one that misses least"


def _bounded(answer: Answer, row: Row) -> str:
    """Return which values of a plan stand at a bound of the study file."""
    held = at_bounds(_record(answer).entrance, row)
    return f" (at a bound of the study: {', '.join(held)})" if held else ""


def _beyond_said(answer: Answer) -> str:
    ours = answer.frames["beyond"]
    said_of = []
    for row in records(ours[ours["plan"] == EXPECTED]):
        missed = f"miss by more than {row['limit_mm']:g} mm"
        said_of.append(
            f"{_percent(row['share'])} {missed if row['what'] == TARGET else 'touch ' + row['what']}"
        )
    return f"{', '.join(said_of)}."


def layouts(answer: Answer) -> list[Display]:
    """Return the plans with their misses, and how often they miss by more than is allowed."""
    plans, beyond = records(answer.frames["plans"]), answer.frames["beyond"]
    head = (text("Plan", wide=True), Column("Offset", "mm"), Column("Angle", "°"), Column("Depth", "mm"))
    ends = (Column("Bevel"), Column("Half miss by", "mm"), Column("95 % by", "mm"), Column("rms", "mm"))
    columns = (*head, *ends, Column("Bias x, y", "mm"), Column("Spread", "mm"))
    entrance = _record(answer).entrance
    cells = tuple(_cells(row, at_bounds(entrance, row)) for row in plans)
    note = (
        "Misses of fresh draws of the parameters, with errors of entry, depth and layers. Bias: the mean tip "
        "less the target. Spread: root mean square distance from the mean tip."
    )
    caption = "The plans, and by how much they miss."
    marked = any(at_bounds(entrance, row) for row in plans)
    notes = (note, *(("* At a bound of the study file.",) if marked else ()))
    table = Display("plans", caption, columns, cells, strong=(0,), notes=notes)
    limits = beyond[["what", "limit_mm"]].drop_duplicates().itertuples(index=False)
    heads = [f"misses by > {limit:g} mm" if what == TARGET else f"touches {what}" for what, limit in limits]
    rows = tuple(
        (NAMES[name], *(_share(row) for row in records(beyond[beyond["plan"] == name])))
        for name in dict.fromkeys(str(row["plan"]) for row in plans)
    )
    shares = (text("Plan", wide=True), *(Column(one, "%") for one in heads))
    caption = "How often the needle misses by more, or touches what it should not."
    note = "In brackets the 95 % interval of the share (Wilson)."
    return [table, Display("beyond", caption, shares, rows, strong=(0,), notes=(note,))]


def _cells(row: Row, bounded: Collection[str]) -> tuple[str, ...]:
    """Return the cells of a plan; values at a bound have a star."""
    values = {"offset": row["offset_mm"], "angle": row["angle_deg"], "depth": row["depth_mm"]}
    aim = (f"{_signed(value)}{'*' if name in bounded else ''}" for name, value in values.items())
    bias = f"{_signed(row['bias_x_mm'], 2)}, {_signed(row['bias_y_mm'], 2)}"
    misses = (fixed(row[name]) for name in ("median_mm", "miss_95_mm", "rms_mm"))
    side = "+y" if row["bevel_side"] > 0 else "−y"
    return (NAMES[str(row["plan"])], *aim, side, *misses, bias, fixed(row["spread_mm"]))


def draw_plan(answer: Answer, folder: Path) -> dict[str, Path]:
    """Draw the plan in its plane, and how far the needles of all plans miss."""
    return {
        "needles": draw(folder / "needles.pdf", lambda: _paint_plane(answer)),
        "misses": draw(folder / "misses.pdf", lambda: _paint_misses(answer)),
    }


def _paint_plane(answer: Answer) -> Figure:
    record, needles = _record(answer), answer.frames["needles"]
    x, y = record.target_mm
    circles = [(*one.centre_mm, one.radius_mm) for one in record.obstacles]
    rims = [y, *(b - r for _, b, r in circles), *(b + r for _, b, r in circles)]
    low, high = min(needles["y_mm"].min(), *rims) - 4, max(needles["y_mm"].max(), *rims) + 4
    right = max(float(needles["x_mm"].max()), x) + 6
    figure = Figure(figsize=(WIDTH, 0.8 + 0.68 * WIDTH * (high - low) / (right + 30)))
    axes, near = figure.subplots(1, 2, width_ratios=(3.2, 1))
    _paint_layers(axes, answer.frames["layers"], right)
    for name, rows in needles[needles["trial"] == -1].groupby("plan", sort=False):
        style = (0, (5, 2)) if name != EXPECTED else "-"
        axes.plot(rows["x_mm"], rows["y_mm"], color=COLOURS[str(name)], lw=1.0, ls=style, zorder=3)
    for _, rows in needles[(needles["plan"] == EXPECTED) & (needles["trial"] >= 0)].groupby("trial"):
        axes.plot(rows["x_mm"], rows["y_mm"], color=COLOURS[EXPECTED], lw=0.35, alpha=0.3)
    axes.add_patch(Circle((x, y), max(record.tolerances_mm), fill=False, ec=INK, lw=0.7, zorder=4))
    for one in record.obstacles:
        axes.add_patch(Circle(one.centre_mm, one.radius_mm, fc=SYNTHETIC, ec="none", alpha=0.35))
        above = one.centre_mm[1] + one.radius_mm + 0.5
        axes.text(one.centre_mm[0], above, one.name, fontsize=6.5, ha="center", va="bottom", color=SYNTHETIC)
    _name_entries(axes, needles)
    axes.set(xlim=(-30, right), ylim=(low, high), xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    axes.set_xticks([tick for tick in axes.get_xticks() if 0 <= tick <= right])
    _paint_target(near, answer)
    label_origin(figure, answer.synthetic)
    return figure


def _paint_target(axes: Axes, answer: Answer) -> None:
    """Draw where the plan's needles end, with the tolerances about the target."""
    record, misses = _record(answer), answer.frames["misses"]
    (x, y), wide = record.target_mm, max(record.tolerances_mm)
    ours = misses[misses["plan"] == EXPECTED]
    axes.plot(ours["x_mm"], ours["y_mm"], ".", color=COLOURS[EXPECTED], ms=2.2, alpha=0.5, mew=0)
    for limit in record.tolerances_mm:
        axes.add_patch(Circle((x, y), limit, fill=False, ec=INK, lw=0.6))
        axes.text(x, y + limit, f"{limit:g} mm", fontsize=6, ha="center", va="bottom", color=INK)
    axes.plot(x, y, "+", color=INK, ms=6, mew=0.8)
    half = 1.2 * wide
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), xlabel="x (mm)", aspect="equal")
    axes.set_title("tips at the target", loc="left")


def _paint_layers(axes: Axes, layers: pd.DataFrame, right: float) -> None:
    """Shade the layers, and number them along the lower edge."""
    step = float(np.diff(np.sort(layers["y_mm"].unique())).min()) if len(layers) else 0.0
    for _, rows in layers.sort_values("y_mm").groupby(["interval", "layer"]):
        layer = int(rows["layer"].iloc[0])
        y, starts, ends = (rows[name].to_numpy(dtype=np.float64) for name in ("y_mm", "from_mm", "to_mm"))
        starts, ends = np.minimum(starts, right), np.minimum(ends, right)
        for run in np.split(np.arange(len(y)), np.flatnonzero(np.diff(y) > 1.5 * step) + 1):
            shade = _SHADES[(layer - 1) % len(_SHADES)]
            axes.fill_betweenx(y[run], starts[run], ends[run], color=shade, lw=0, zorder=0)
        middle = 0.5 * float(np.median(starts) + np.median(ends))
        low = axes.get_xaxis_transform()
        axes.text(middle, 0.01, f"{layer}", transform=low, ha="center", va="bottom", color=GREY)


def _name_entries(axes: Axes, needles: pd.DataFrame) -> None:
    """Write the plans' names where their needles enter."""
    first = needles[needles["trial"] == -1].groupby("plan", sort=False)["y_mm"].first().sort_values()
    at = apart(first.to_numpy(dtype=np.float64), 1.9 * np.arange(len(first), dtype=np.float64))
    for (name, entry), place in zip(first.items(), at.tolist(), strict=True):
        colour = COLOURS[str(name)]
        axes.plot([-1.5, 0], [place, entry], color=colour, lw=0.5)
        axes.text(-2, place, NAMES[str(name)], ha="right", va="center", fontsize=6.5, color=colour)


def _paint_misses(answer: Answer) -> Figure:
    figure = Figure(figsize=(WIDTH, 2.5))
    axes = figure.add_subplot()
    misses = answer.frames["misses"]
    axes.set_xscale("log")
    for place, (name, rows) in enumerate(misses.groupby("plan", sort=False)):
        miss = np.sort(rows["miss_mm"].to_numpy(dtype=np.float64))
        share = np.arange(1, len(miss) + 1) / len(miss)
        colour, ours = COLOURS[str(name)], name == EXPECTED
        axes.step(miss, share, where="post", color=colour, lw=1.6 if ours else 1.1)
        level = 0.55 if ours else 0.15 + 0.12 * place
        beside, side = (0.95, "right") if ours else (1.06, "left")
        at = beside * float(np.quantile(miss, level))
        axes.text(at, level, NAMES[str(name)], color=colour, fontsize=6.5, ha=side, va="center")
    for limit in _record(answer).tolerances_mm:
        axes.axvline(limit, color=INK, lw=0.5, ls=(0, (2, 2)), zorder=0)
    low, high = misses["miss_mm"].quantile([0.005, 1.0])
    axes.set(xlim=(0.8 * low, 1.3 * high), ylim=(0, 1.01), xlabel="miss of the tip (mm)")
    axes.set_ylabel("share of needles")
    ticks = [tick * 10.0**power for power in range(-3, 3) for tick in (1, 2, 5)]
    axes.set_xticks([tick for tick in ticks if low <= tick <= high], minor=False)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    light_grid(axes, "y")
    label_origin(figure, answer.synthetic)
    return figure


def story(answer: Answer, figures: Figures) -> list[Block]:
    """Return the plan drawn, tables and misses, and what is behind them."""
    captions = {
        "needles": "The plan in its plane: the needle of the mean parameters (thick), those of fresh draws "
        "(thin), and rival plans (dashed); right, where all of its needles end. Numbers name the layers.",
        "misses": "Share of needles that miss by at most so much; dashed lines are the tolerances.",
    }
    tables = [document.table(table, answer.synthetic) for table in layouts(answer)]
    drawn = [document.figure(path, captions[name], answer.synthetic) for name, path in figures.items()]
    behind = [document.text(_behind(answer, row)) for row in records(answer.frames["posterior"])]
    return [document.heading("The plan"), *drawn, *tables, document.heading("How"), *behind]


def _behind(answer: Answer, now: Row) -> str:
    entrance = _record(answer).entrance
    made = f"{now['insertions']} insertion{'s' if now['insertions'] > 1 else ''}"
    source = "sampled" if now["sampled"] else f"weighed, Pareto k {now['pareto_k']:.2f}"
    ranges = {"offset": entrance.offset_mm, "angle": entrance.angle_deg, "depth": entrance.depth_mm}
    units = {"offset": " mm", "angle": "°", "depth": " mm"}
    within = ", ".join(
        f"{name} {_signed(low, 0)} to {_signed(high, 0)}{units[name]}" for name, (low, high) in ranges.items()
    )
    return (
        f"The plan minimises the mean squared miss over draws of the posterior of {made} ({source}), always "
        "the same draws with the same errors of entry, depth and layers; a penalty keeps it away from "
        f"obstacles. Searched: {within}, both sides of the bevel, from several straight aims. Where "
        "parameters are taken for certain many plans hit: the one found first is shown. Needles that go "
        "elsewhere because the model is wrong are not in these misses."
    )


def _record(answer: Answer) -> PlanRecord:
    assert isinstance(answer.record, PlanRecord)
    return answer.record


def _signed(value: float | None, digits: int = 1) -> str:
    return fixed(value, digits).replace("-", "−")


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


def _share(row: Row) -> str:
    if row["share"] is None:
        return "–"
    return f"{100 * row['share']:.0f} ({100 * row['low']:.0f}–{100 * row['high']:.0f})"


PAGE = Page(said, layouts, draw_plan, story)
