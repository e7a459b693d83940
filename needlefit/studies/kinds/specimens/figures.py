"""Figures of specimens and the spread between them, or of the recovery of a known population."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw_grid, plot
from needlefit.reporting.labels import GREY, POPULATION_NAMES
from needlefit.reporting.number_format import format_bare_symbol
from needlefit.reporting.table_files import to_records
from needlefit.studies.kinds.specimens.run import BEST_DETERMINED
from needlefit.studies.run import Run

DENSITY_COLOURS = ("#0072B2", "#D55E00")


def draw_specimens(result: Run, path: Path) -> Path:
    """Draw the posterior of each specimen: mean and standard deviation."""
    return plot(path, result.frames["specimens"].assign(origin=result.origin), _paint_specimens)


def draw_densities(result: Run, path: Path) -> Path:
    """Draw the posterior density of each spread with its prior, over the 95 % interval."""
    known = result.frames["population"]
    reach = known[known["quantity"] == "spread"][["groups", "parameter", "high_95"]]
    densities = result.frames["densities"].merge(reach, how="left", on=["groups", "parameter"])
    return plot(path, densities.assign(origin=result.origin), _paint_densities)


def draw_recovered(result: Run, path: Path) -> Path:
    """Draw the intervals of every replicate with the true value, grouped by the true spread."""
    return plot(path, result.frames["recovered"].assign(origin=result.origin), _paint_recovered)


def _paint_specimens(every: pd.DataFrame) -> Figure:
    names, groups = (list(dict.fromkeys(every[column].astype(str))) for column in ("parameter", "groups"))
    order = every.drop_duplicates(["groups", "specimen"])[["groups", "specimen"]].reset_index(drop=True)
    figure = Figure(figsize=(TEXT_WIDTH_IN, 0.7 + 0.16 * len(order)))
    panels = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for axes, name in zip(panels, names, strict=True):
        rows = order.merge(every[every["parameter"] == name], on=["groups", "specimen"])
        for y, row in enumerate(to_records(rows)):
            colour = DENSITY_COLOURS[groups.index(row["groups"]) % len(DENSITY_COLOURS)]
            axes.plot([row["mean"] - row["sd"], row["mean"] + row["sd"]], [y, y], color=colour, lw=1.1)
            axes.plot(row["mean"], y, "o", color=colour, ms=3)
        axes.set_xlabel(_axis_label(name))
        draw_grid(axes, "x")
        axes.tick_params(axis="y", length=0)
    panels[0].set_yticks(range(len(order)), [str(name) for name in order["specimen"]])
    panels[0].set_ylim(len(order) - 0.5, -0.5)
    return figure


def _paint_densities(every: pd.DataFrame) -> Figure:
    names = [str(name) for name in every["parameter"].unique()]
    figure = Figure(figsize=(TEXT_WIDTH_IN, 2.3))
    panels = figure.subplots(1, len(names), squeeze=False)[0]
    for axes, name in zip(panels, names, strict=True):
        _paint_spread(axes, every[every["parameter"] == name])
        axes.set_xlabel(
            "spread of the best-determined combination"
            if name == BEST_DETERMINED
            else f"spread of {_axis_label(name)}"
        )
    panels[0].set_ylabel("posterior density")
    return figure


def _paint_spread(axes: Axes, densities: pd.DataFrame) -> None:
    """Draw the densities of one parameter's spread, a line for each way to group, and the prior."""
    far, groups = float(densities["high_95"].max()), list(dict.fromkeys(densities["groups"]))
    for place, what in enumerate(groups):
        rows, colour = densities[densities["groups"] == what], DENSITY_COLOURS[place % len(DENSITY_COLOURS)]
        x, y = (rows[key].to_numpy(dtype=np.float64) for key in ("spread", "density"))
        axes.plot(x, y, color=colour, lw=1.3)
        top = int(np.argmax(y))
        axes.text(x[top] + 0.02 * far, y[top], f"{what}s", color=colour, fontsize=6.5, va="bottom")
    prior = densities[densities["groups"] == groups[0]]
    axes.plot(prior["spread"], prior["prior"], color=GREY, lw=0.8, ls=(0, (4, 3)))
    if prior["prior"].notna().all():
        at, height = (prior[key].to_numpy(dtype=np.float64) for key in ("spread", "prior"))
        right = 0.8 * far
        axes.text(right, np.interp(right, at, height), "prior", color=GREY, fontsize=6.5, va="bottom")
    axes.set(xlim=(0, 1.15 * far), ylim=(0, 1.15 * float(densities["density"].max())))
    axes.set_yticks([])


def _paint_recovered(every: pd.DataFrame) -> Figure:
    names = [str(name) for name in every["parameter"].unique()]
    figure = Figure(figsize=(TEXT_WIDTH_IN, 0.5 + 1.35 * len(names)))
    panels = figure.subplots(len(names), 2, squeeze=False, sharex=True)
    for row, name in zip(panels, names, strict=True):
        for axes, what in zip(row, ("mean", "spread"), strict=True):
            _paint_intervals(axes, every[(every["parameter"] == name) & (every["quantity"] == what)])
            axes.set_title(f"{POPULATION_NAMES[what]} of {_axis_label(name)}", loc="left")
    return figure


def _paint_intervals(axes: Axes, rows: pd.DataFrame) -> None:
    ticks, at = [], 0
    for spread, same in rows.groupby("spread", sort=False):
        x = at + np.arange(len(same))
        axes.vlines(x, same["low_95"], same["high_95"], color=DENSITY_COLOURS[0], lw=0.9)
        axes.vlines(x, same["low_50"], same["high_50"], color=DENSITY_COLOURS[0], lw=2.4)
        truth = float(same["truth"].iloc[0])
        axes.plot([x[0] - 0.5, x[-1] + 0.5], [truth, truth], color=DENSITY_COLOURS[1], lw=1.1, zorder=3)
        ticks.append((float(x.mean()), f"true spread\n{spread:g}"))
        at = int(x[-1]) + 3
    axes.set_xticks([place for place, _ in ticks], [words for _, words in ticks])
    axes.tick_params(axis="x", length=0)
    draw_grid(axes, "y")


def _axis_label(name: str) -> str:
    called = format_bare_symbol(name)
    return f"ln {called}" if is_logarithmic(name) else called
