"""Collect what the HTML report draws interactively: the curves of every insertion, and posterior draws."""

from typing import Any

import numpy as np
import pandas as pd

from needlefit.inference.parameters import is_logarithmic
from needlefit.metrics import list_metrics
from needlefit.reporting.figures.fit_forms import HEIGHT_COLUMNS
from needlefit.reporting.labels import group_name, layers_name, medium_name, method_colour, method_name
from needlefit.reporting.number_format import choose_printed_unit, format_metric
from needlefit.reporting.table_files import to_records
from needlefit.studies.kinds.cross_validation.facts import find_scored_role
from needlefit.studies.kinds.cross_validation.figures import collect_curves, subtract_fit
from needlefit.studies.kinds.cross_validation.posterior import list_free_parameters
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
    listed_curves, listed_residuals = _list_curves(curves), _list_curves(subtract_fit(curves))
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
                "curves": listed_curves.get((row["fold"], row["insertion"]), {}),
                "residuals": listed_residuals.get((row["fold"], row["insertion"]), {}),
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


def _list_curves(points: pd.DataFrame) -> dict[tuple[str, str], dict[str, dict[str, list[float]]]]:
    """Return the curves by fold and insertion, of each its columns; points that lack one are left out."""
    found: dict[tuple[str, str], dict[str, dict[str, list[float]]]] = {}
    every = {key: points[key].to_numpy(dtype=np.float64) for key in ("x_mm", *HEIGHT_COLUMNS)}
    groups: dict[Any, Any] = points.groupby(["fold", "insertion", "curve"], sort=False).indices
    for (fold, insertion, name), rows in sorted(groups.items(), key=lambda group: int(group[1][0])):
        heights = HEIGHT_COLUMNS[1:] if str(name).endswith("%") else HEIGHT_COLUMNS[:1]
        columns = np.array([every[key][rows] for key in ("x_mm", *heights)])
        known = np.round(columns[:, ~np.isnan(columns).any(axis=0)], CURVE_DECIMALS).tolist()
        found.setdefault((fold, insertion), {})[str(name)] = dict(zip(("x_mm", *heights), known, strict=True))
    return found


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
