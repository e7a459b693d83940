"""Collect what the HTML report draws interactively: the curves of every insertion, and posterior draws."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from needlefit.inference.parameters import is_logarithmic
from needlefit.metrics import list_metrics
from needlefit.reporting.labels import group_name, layers_name, medium_name, method_colour, method_name
from needlefit.reporting.number_format import choose_printed_unit, format_metric
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies.kinds.cross_validation.figures.insertions import (
    HEIGHT_COLUMNS,
    collect_curves,
    subtract_fit,
)
from needlefit.studies.kinds.cross_validation.posterior import list_free_parameters
from needlefit.studies.kinds.cross_validation.sentences import find_scored_role
from needlefit.studies.run import Run
from needlefit.studies.score import list_methods
from needlefit.studies.verdict import judge_run

CURVE_DECIMALS = 3
"""Of mm on the page."""

MAX_EXPLORED_PARAMETERS = 6


def collect_explorer(results: Run) -> dict[str, Any] | None:
    """Return the values of the interactive part of the page; None where nothing was scored."""
    role = find_scored_role(results)
    scored = results.frames["errors"].query(
        "role == @role and boundaries == 'measured' and method == 'fitted' and converged"
    )
    if scored.empty:
        return None
    methods = ("fitted", *(name for name in list_methods() if name != "fitted"))
    curves = collect_curves(results, role, methods)
    residuals = subtract_fit(curves)
    status = {one.group: one.status for one in judge_run(results)}
    metrics = [one for one in list_metrics() if one.headline or one.relative]
    return {
        "heads": ["Insertion", "Group", "Depth (mm)", *(f"{one.label} ({one.unit})" for one in metrics)],
        "insertions": [
            {
                "cells": [
                    row["insertion"],
                    f"{medium_name(row['medium'])}, {layers_name(row['layers'])}",
                    f"{row['depth_mm']:.1f}",
                    *(format_metric(one, row[one.name]) for one in metrics),
                ],
                # a verdict names the layers only where a medium has several groups
                "status": status.get(
                    group_name(row["medium"], row["layers"]), status.get(medium_name(row["medium"]), "")
                ),
                "error": row["te_mm"],
                "curves": dict(_list_curves(curves, row)),
                "residuals": dict(_list_curves(residuals, row)),
            }
            for row in to_records(scored)
        ],
        "methods": [
            {"key": name, "name": method_name(name, results.origin), "colour": method_colour(name)}
            for name in methods
            if (curves["curve"] == name).any()
        ],
        "posterior": _collect_draws(results),
    }


def _list_curves(points: pd.DataFrame, row: Row) -> Iterator[tuple[str, dict[str, list[float]]]]:
    mine = points[(points["fold"] == row["fold"]) & (points["insertion"] == row["insertion"])]
    for name, curve in mine.groupby("curve", sort=False):
        columns = ("x_mm", *(HEIGHT_COLUMNS[1:] if str(name).endswith("%") else HEIGHT_COLUMNS[:1]))
        known = curve.dropna(subset=list(columns))
        yield str(name), {key: _round(known[key]) for key in columns}


def _round(values: "pd.Series[float]") -> list[float]:
    rounded: list[float] = np.round(values.to_numpy(dtype=np.float64), CURVE_DECIMALS).tolist()
    return rounded


def _collect_draws(results: Run) -> dict[str, Any] | None:
    """Return the draws of the first fold, moduli in kPa or MPa; None without draws or with one parameter."""
    names = list_free_parameters(results)[:MAX_EXPLORED_PARAMETERS]
    draws = results.frames["draws"]
    if draws.empty or len(names) < 2:
        return None
    draws = draws[draws["fold"] == draws["fold"].iloc[0]]
    parameters = []
    for name in names:
        values = draws[name].to_numpy(dtype=np.float64)
        label, unit = choose_printed_unit(name, [float(np.median(values))])
        digits = [float(f"{value / unit:.4g}") for value in values]
        parameters.append({"label": label, "log": is_logarithmic(name), "values": digits})
    return {"parameters": parameters}
