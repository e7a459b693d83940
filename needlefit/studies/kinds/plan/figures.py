"""Figures of a plan: the plan in its plane, and the misses of its needles and of the alternatives."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from needlefit.reporting.figures.style import (
    TEXT_WIDTH_IN,
    draw_grid,
    plot,
    separate_positions,
)
from needlefit.reporting.labels import GREY, INK, PLAN_COLOURS, PLAN_NAMES, SYNTHETIC_COLOUR
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies.kinds.plan.run import EXPECTED
from needlefit.studies.kinds.plan.schema import PlanRecord
from needlefit.studies.run import Run

_LAYER_COLOURS = ("#f7f4ee", "#e2d9c6", "#efeadd", "#d3c7ae", "#e9e2d2")
_PLANE_COLUMNS = ("mark", "method", "trial", "x_mm", "y_mm", "object", "radius_mm")
_LAYER_COLUMNS = ("interval", "layer", "low_mm", "high_mm")


def draw_plane(result: Run, path: Path) -> Path:
    """Draw layers, needles, target and obstacles; beside them where the plan's needles end."""
    return plot(path, _tabulate_plane(result), _paint_plane)


def draw_misses(result: Run, path: Path) -> Path:
    """Draw, for each plan, the share of needles that miss by at most a given distance."""
    return plot(path, _tabulate_misses(result), _paint_misses)


def _tabulate_plane(result: Run) -> pd.DataFrame:
    """Return needles, tips of the plan, layers, and the circles about target and obstacles."""
    record, frames = result.record, result.frames
    assert isinstance(record, PlanRecord)
    tips = frames["misses"][frames["misses"]["method"] == EXPECTED].drop(columns="miss_mm")
    parts = [frames["needles"].assign(mark="needle"), tips.assign(mark="tip")]
    parts += [frames["layers"].assign(mark="layer"), pd.DataFrame(_circle_rows(record))]
    columns = [*_PLANE_COLUMNS, *_LAYER_COLUMNS]
    every = pd.concat([part.reindex(columns=columns) for part in parts if len(part)], ignore_index=True)
    whole = dict.fromkeys(("trial", "interval", "layer"), "Int64")
    return every.astype(whole).assign(origin=result.origin)


def _circle_rows(record: PlanRecord) -> list[Row]:
    """Return a row for each tolerance about the target, and for each obstacle."""
    about = [("tolerance", "", record.target_mm, limit) for limit in record.tolerances_mm]
    about += [("obstacle", one.name, one.centre_mm, one.radius_mm) for one in record.obstacles]
    return [
        {"mark": part, "object": name, "x_mm": x, "y_mm": y, "radius_mm": radius}
        for part, name, (x, y), radius in about
    ]


def _tabulate_misses(result: Run) -> pd.DataFrame:
    """Return the steps of each plan's share of needles, and the tolerances."""
    record = result.record
    assert isinstance(record, PlanRecord)
    parts = []
    for name, rows in result.frames["misses"].groupby("method", sort=False):
        miss = np.sort(rows["miss_mm"].to_numpy(dtype=np.float64))
        share = np.arange(1, len(miss) + 1) / len(miss)
        parts.append(pd.DataFrame({"mark": "needles", "method": name, "miss_mm": miss, "share": share}))
    parts.append(pd.DataFrame({"mark": "tolerance", "miss_mm": record.tolerances_mm}))
    return pd.concat(parts, ignore_index=True).assign(origin=result.origin)


def _paint_plane(plane: pd.DataFrame) -> Figure:
    needles, tolerances, obstacles = (
        _select_part(plane, name) for name in ("needle", "tolerance", "obstacle")
    )
    target = to_records(tolerances.nlargest(1, "radius_mm"))[0]
    rims = [target["y_mm"], *(obstacles["y_mm"] - obstacles["radius_mm"])]
    rims += [*(obstacles["y_mm"] + obstacles["radius_mm"])]
    low, high = min(needles["y_mm"].min(), *rims) - 4, max(needles["y_mm"].max(), *rims) + 4
    right = max(float(needles["x_mm"].max()), target["x_mm"]) + 6
    figure = Figure(figsize=(TEXT_WIDTH_IN, 0.8 + 0.68 * TEXT_WIDTH_IN * (high - low) / (right + 30)))
    axes, near = figure.subplots(1, 2, width_ratios=(3.2, 1))
    _paint_layers(axes, _select_part(plane, "layer"), right)
    _paint_needles(axes, needles)
    axes.add_patch(_make_circle(target, fill=False, ec=INK, lw=0.7, zorder=4))
    for row in to_records(obstacles):
        axes.add_patch(_make_circle(row, fc=SYNTHETIC_COLOUR, ec="none", alpha=0.35))
        above = {"ha": "center", "va": "bottom", "color": SYNTHETIC_COLOUR}
        axes.text(row["x_mm"], row["y_mm"] + row["radius_mm"] + 0.5, row["object"], fontsize=6.5, **above)
    axes.set(xlim=(-30, right), ylim=(low, high), xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    axes.set_xticks([tick for tick in axes.get_xticks() if 0 <= tick <= right])
    _paint_target(near, _select_part(plane, "tip"), tolerances)
    return figure


def _select_part(table: pd.DataFrame, name: str) -> pd.DataFrame:
    return table[table["mark"] == name]


def _make_circle(row: Row, **style: object) -> Circle:
    return Circle((row["x_mm"], row["y_mm"]), row["radius_mm"], **style)


def _paint_needles(axes: Axes, needles: pd.DataFrame) -> None:
    """Draw the needle of every plan, and for ours those of the draws, thin; name them where they enter."""
    planned, drawn = needles[needles["trial"] == -1], needles[needles["trial"] >= 0]
    for name, rows in planned.groupby("method", sort=False):
        style = (0, (5, 2)) if name != EXPECTED else "-"
        axes.plot(rows["x_mm"], rows["y_mm"], color=PLAN_COLOURS[str(name)], lw=1.0, ls=style, zorder=3)
    for (plan, _), rows in drawn.groupby(["method", "trial"]):
        axes.plot(rows["x_mm"], rows["y_mm"], color=PLAN_COLOURS[str(plan)], lw=0.35, alpha=0.3)
    first = planned.groupby("method", sort=False)["y_mm"].first().sort_values()
    at = separate_positions(first.to_numpy(dtype=np.float64), 1.9 * np.arange(len(first), dtype=np.float64))
    for (plan, entry), place in zip(first.items(), at.tolist(), strict=True):
        colour = PLAN_COLOURS[str(plan)]
        axes.plot([-1.5, 0], [place, entry], color=colour, lw=0.5)
        axes.text(-2, place, PLAN_NAMES[str(plan)], ha="right", va="center", fontsize=6.5, color=colour)


def _paint_target(axes: Axes, tips: pd.DataFrame, tolerances: pd.DataFrame) -> None:
    """Draw where the plan's needles end, with the tolerances about the target."""
    axes.plot(tips["x_mm"], tips["y_mm"], ".", color=PLAN_COLOURS[EXPECTED], ms=2.2, alpha=0.5, mew=0)
    for row in to_records(tolerances):
        axes.add_patch(_make_circle(row, fill=False, ec=INK, lw=0.6))
        top, summary = row["y_mm"] + row["radius_mm"], f"{row['radius_mm']:g} mm"
        axes.text(row["x_mm"], top, summary, fontsize=6, ha="center", va="bottom", color=INK)
    x, y = (float(tolerances[axis].iloc[0]) for axis in ("x_mm", "y_mm"))
    axes.plot(x, y, "+", color=INK, ms=6, mew=0.8)
    half = 1.2 * float(tolerances["radius_mm"].max())
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), xlabel="x (mm)", aspect="equal")
    axes.set_title("tips at the target", loc="left")


def _paint_layers(axes: Axes, layers: pd.DataFrame, right: float) -> None:
    """Shade the layers, and number them along the lower edge."""
    step = float(np.diff(np.sort(layers["y_mm"].unique())).min()) if len(layers) else 0.0
    for _, rows in layers.sort_values("y_mm").groupby(["interval", "layer"]):
        layer = int(rows["layer"].iloc[0])
        y, starts, ends = (rows[name].to_numpy(dtype=np.float64) for name in ("y_mm", "low_mm", "high_mm"))
        starts, ends = np.minimum(starts, right), np.minimum(ends, right)
        for run in np.split(np.arange(len(y)), np.flatnonzero(np.diff(y) > 1.5 * step) + 1):
            shade = _LAYER_COLOURS[(layer - 1) % len(_LAYER_COLOURS)]
            axes.fill_betweenx(y[run], starts[run], ends[run], color=shade, lw=0, zorder=0)
        middle = 0.5 * float(np.median(starts) + np.median(ends))
        low = axes.get_xaxis_transform()
        axes.text(middle, 0.01, f"{layer}", transform=low, ha="center", va="bottom", color=GREY)


def _paint_misses(within: pd.DataFrame) -> Figure:
    figure = Figure(figsize=(TEXT_WIDTH_IN, 2.5))
    axes = figure.add_subplot()
    axes.set_xscale("log")
    misses = _select_part(within, "needles")
    for place, (name, rows) in enumerate(misses.groupby("method", sort=False)):
        colour, ours = PLAN_COLOURS[str(name)], name == EXPECTED
        axes.step(rows["miss_mm"], rows["share"], where="post", color=colour, lw=1.6 if ours else 1.1)
        level = 0.55 if ours else 0.15 + 0.12 * place
        beside, side = (0.95, "right") if ours else (1.06, "left")
        at = beside * float(rows["miss_mm"].quantile(level))
        axes.text(at, level, PLAN_NAMES[str(name)], color=colour, fontsize=6.5, ha=side, va="center")
    for limit in _select_part(within, "tolerance")["miss_mm"]:
        axes.axvline(limit, color=INK, lw=0.5, ls=(0, (2, 2)), zorder=0)
    low, high = misses["miss_mm"].quantile([0.005, 1.0])
    axes.set(xlim=(0.8 * low, 1.3 * high), ylim=(0, 1.01), xlabel="miss of the tip (mm)")
    axes.set_ylabel("share of needles")
    ticks = [tick * 10.0**power for power in range(-3, 3) for tick in (1, 2, 5)]
    axes.set_xticks([tick for tick in ticks if low <= tick <= high], minor=False)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    draw_grid(axes, "y")
    return figure
