"""The posteriors of a run: files, the table of percentiles, and the ridge of the draws.

The ridge on which a posterior lies: where parameters can move together and the needles stay what they are.

It is the longest principal axis of the draws, in logarithms of moduli and lengths; across it lies what the
data determine.
"""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.inference.identifiability.precision import Direction, principal_directions
from needlefit.inference.parameters import is_logarithmic
from needlefit.inference.sampling.posterior import PERCENTILES, Posterior
from needlefit.reporting.figures.fit_forms import to_log_coordinates
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies.run import Run


def tabulate_percentiles(results: Run) -> pd.DataFrame:
    """Return one row per fold and free parameter: percentiles (Pa, mm), the fitted value, R-hat.

    `fit_value_used` is what the fit ended with and its predictions used; `fit_in_central_95` is false where
    that lies outside the central 95 % of the draws: a peak need not lie where most of a density is, and a
    fit of the recipe's error metrics need not agree with a posterior at all. `acceptance` is the fold's;
    `ess_bulk` and `ess_tail` are the independent draws of the ensemble that has fewest. `converged` is false
    where the criteria, which concern more than the parameters, are not met: percentiles are then not final.
    `determined` is false where the fit's value is no estimate; the percentiles then depend on the bounds too.
    """
    fits = {(str(r["fold"]), r["parameter"]): r for r in _fitted_rows(results)}
    rows = [
        row
        for fold, posterior in results.posteriors.items()
        for row in _percentile_rows(fold, posterior, fits)
    ]
    heads = ("fold", "parameter", *map(_percentile_column, PERCENTILES), "fit_value_used", "determined")
    heads += ("fit_in_central_95",)
    heads += ("r_hat", "ess_bulk", "ess_tail", "acceptance", "converged", "origin")
    return pd.DataFrame([{**row, "origin": results.origin} for row in rows], columns=heads)


def _fitted_rows(results: Run) -> list[Row]:
    return [row for row in to_records(results.frames["parameters"]) if row["method"] == "fitted"]


def _percentile_rows(
    fold: str, posterior: Posterior, fits: Mapping[tuple[str, str], Row]
) -> list[dict[str, object]]:
    sampler = {"acceptance": float(np.mean(posterior.acceptance)), "converged": posterior.converged}
    found = posterior.convergence
    return [
        {
            "fold": fold,
            "parameter": name,
            **dict(zip(map(_percentile_column, PERCENTILES), values, strict=True)),
            **_compare_with_fit(fits.get((str(fold), name)), values),
            "r_hat": float(found.r_hat[number]),
            "ess_bulk": float(found.ess_bulk[:, number].min()),
            "ess_tail": float(found.ess_tail[:, number].min()),
            **sampler,
        }
        for number, (name, values) in enumerate(posterior.percentiles().items())
    ]


def _compare_with_fit(fitted: Row | None, percentiles: tuple[float, ...]) -> dict[str, object]:
    """Return the fit's value, whether the data determine it, and whether the percentiles hold it."""
    if fitted is None or fitted["value"] is None:
        return {"fit_value_used": None, "determined": None, "fit_in_central_95": None}
    inside = percentiles[0] <= fitted["value"] <= percentiles[-1]
    determined = bool(fitted["determined"])
    return {"fit_value_used": fitted["value"], "determined": determined, "fit_in_central_95": inside}


def _percentile_column(percentile: float) -> str:
    return f"p{percentile:g}"


RIDGE_MIN_AXIS_RATIO = 3.0
"""Least ratio of the longest to the shortest axis of the draws of a ridge."""

RIDGE_REACH_SD = 2.0
"""Standard deviations to which the ridge is drawn in both directions."""


def list_free_parameters(results: Run) -> list[str]:
    """Return the parameters that were estimated."""
    known = results.frames["parameters"]
    rows = known[(known["method"] == "fitted") & (known["status"] == "free")]
    return list(dict.fromkeys(rows["parameter"]))


def principal_axes(draws: pd.DataFrame) -> tuple[Direction, ...]:
    """Return the principal axes of draws (Pa, mm), the shortest (best determined) first."""
    names = [str(name) for name in draws.columns]
    spread = np.atleast_2d(np.cov(to_log_coordinates(draws), rowvar=False))
    # The inverse covariance of the draws plays the part of the Fisher information.
    information: Floats = np.linalg.pinv(spread, hermitian=True).astype(np.float64)
    return principal_directions(information, names)


def is_ridge(axes: tuple[Direction, ...]) -> bool:
    """Return whether draws with these axes are elongated along the longest one."""
    return len(axes) > 1 and axes[-1].sd > RIDGE_MIN_AXIS_RATIO * axes[0].sd


def find_ridge_ends(draws: pd.DataFrame) -> list[dict[str, float]]:
    """Return both ends of the ridge, Pa and mm; none if the draws have no longest axis."""
    axes = principal_axes(draws)
    if not is_ridge(axes):
        return []
    middle, step = (
        to_log_coordinates(draws).mean(axis=0),
        RIDGE_REACH_SD * axes[-1].sd * np.array(axes[-1].weights),
    )
    return [
        {
            str(name): float(np.exp(at) if is_logarithmic(str(name)) else at)
            for name, at in zip(draws.columns, end, strict=True)
        }
        for end in (middle - step, middle + step)
    ]
