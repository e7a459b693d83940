"""Posteriors of a run: their files, and the table of percentiles."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from needlefit.inference.sampling.posterior import PERCENTILES, Posterior, save
from needlefit.reporting.display import Column, Display, text, without_empty
from needlefit.reporting.numbers import fixed, number, symbol, typeset
from needlefit.reporting.parameters import NOT_DETERMINED
from needlefit.reporting.tables import Row, records
from needlefit.validation.results import Results
from needlefit.validation.stored import posterior_file_names


def percentiles_table(results: Results) -> pd.DataFrame:
    """Return one row per fold and free parameter: percentiles (Pa, mm), the fit's own value, R-hat.

    `fit_value_used` is what the fit ended with and its predictions used; `fit_in_central_95` is false where
    that lies outside the central 95 % of the draws: a peak need not lie where most of a density is, and a
    fit of the recipe's error metrics need not agree with a posterior at all. `acceptance` is the fold's;
    `ess_bulk` and `ess_tail` are the independent draws of the ensemble that has fewest. `converged` is false
    where the rule, which asks more than the parameters, is not met: the percentiles are then not final.
    `determined` is false where the fit's value is no estimate, and the percentiles tell of the bounds too.
    """
    fits = {(str(r["fold"]), r["parameter"]): r for r in _fitted(results)}
    rows = [row for fold, posterior in results.posteriors.items() for row in _rows(fold, posterior, fits)]
    heads = ("fold", "parameter", *map(_head, PERCENTILES), "fit_value_used", "determined")
    heads += ("fit_in_central_95",)
    heads += ("r_hat", "ess_bulk", "ess_tail", "acceptance", "converged", "origin")
    return pd.DataFrame([{**row, "origin": results.origin} for row in rows], columns=heads)


def unconverged_said(results: Results) -> str:
    """Return in what the rule of convergence is not met, by fold where there are several, or nothing."""
    several = len(results.posteriors) > 1
    said = [
        (f"{fold}: " if several else "") + "; ".join(posterior.faults)
        for fold, posterior in results.posteriors.items()
        if posterior.faults
    ]
    if not said:
        return ""
    return (
        f"NOT CONVERGED: {'. '.join(said)}. Percentiles and bands drawn from this posterior are not final; "
        "raise the recipe’s sample.steps."
    )


def outside_said(results: Results) -> str:
    """Return which fitted values lie outside the central 95 % of their posterior, or nothing."""
    rows = [row for row in records(percentiles_table(results)) if row["fit_in_central_95"] is False]
    if not rows:
        return ""
    several = len(results.posteriors) > 1
    names = [symbol(row["parameter"]).split(" (")[0] for row in rows]
    where = [f"{name} in {row['fold']}" if several else name for name, row in zip(names, rows, strict=True)]
    by_metric = (results.starts.query("fit == 'fitted'")["minimized"] == "metric").any()
    why = _BY_METRIC if by_metric else _BY_PEAK
    return f"The fit lies outside the central 95 % of the posterior in {', '.join(where)}: {why}"


_BY_METRIC = (
    "the fit minimises the recipe’s error metrics (IPE, TE, EDP), the posterior weighs points by the stated "
    "noise, so the percentiles are no error bars of the fitted values."
)
_BY_PEAK = (
    "the fit is the peak of the density, and where that leans on a bound, or has a narrow hill beside a "
    "broad one, most of the posterior lies elsewhere. The percentiles say what is known, not the peak."
)


def posterior_layout(results: Results) -> Display:
    """Return the percentiles with the fit's own value beside them."""
    table = records(percentiles_table(results))
    rows = tuple(
        (
            *(str(row["fold"]) if len(results.posteriors) > 1 else "", symbol(row["parameter"])),
            *(typeset(number(row[_head(p)])) for p in PERCENTILES),
            _fit_cell(row),
            *(fixed(row["r_hat"], 3), "" if row["converged"] else "NOT CONVERGED"),
        )
        for row in table
    )
    percentiles = (Column(f"{p:g} %") for p in PERCENTILES)
    columns = (text("Fold"), text("Parameter"), *percentiles, Column("Fit"), Column("R-hat"), text("State"))
    marked = any("‡" in _fit_cell(row) for row in table)
    notes = ("‡ outside the central 95 % of the draws.",) if marked else ()
    caption = "Posterior: percentiles of the draws, and the value that the fit ended with."
    caption += " NOT CONVERGED: they are not final." if unconverged_said(results) else ""
    return without_empty(Display("posterior", caption, columns, rows, (), (), notes))


def _fit_cell(row: Row) -> str:
    if row["determined"] is False:
        return NOT_DETERMINED
    return typeset(number(row["fit_value_used"])) + (" ‡" if row["fit_in_central_95"] is False else "")


def posterior_files(results: Results) -> Mapping[str, Callable[[Path], object]]:
    """Return what `write` is to write besides: `posterior.csv`, and each fold's draws as netCDF."""
    if not results.posteriors:
        return {}
    posteriors = results.posteriors.values()
    names = posterior_file_names(len(posteriors))
    draws = {name: partial(save, posterior) for name, posterior in zip(names, posteriors, strict=True)}
    table = percentiles_table(results)
    return {**draws, "posterior.csv": partial(table.to_csv, index=False, float_format="%.8g")}


def _fitted(results: Results) -> list[Row]:
    return [row for row in records(results.parameters) if row["method"] == "fitted"]


def _rows(fold: str, posterior: Posterior, fits: Mapping[tuple[str, str], Row]) -> list[dict[str, object]]:
    about = {"acceptance": float(np.mean(posterior.acceptance)), "converged": posterior.converged}
    found = posterior.convergence
    return [
        {
            "fold": fold,
            "parameter": name,
            **dict(zip(map(_head, PERCENTILES), values, strict=True)),
            **_beside(fits.get((str(fold), name)), values),
            "r_hat": float(found.r_hat[number]),
            "ess_bulk": float(found.ess_bulk[:, number].min()),
            "ess_tail": float(found.ess_tail[:, number].min()),
            **about,
        }
        for number, (name, values) in enumerate(posterior.percentiles().items())
    ]


def _beside(fitted: Row | None, percentiles: tuple[float, ...]) -> dict[str, object]:
    """Return the fit's value, whether the data determine it, and whether the percentiles hold it."""
    if fitted is None or fitted["value"] is None:
        return {"fit_value_used": None, "determined": None, "fit_in_central_95": None}
    inside = percentiles[0] <= fitted["value"] <= percentiles[-1]
    determined = bool(fitted["determined"])
    return {"fit_value_used": fitted["value"], "determined": determined, "fit_in_central_95": inside}


def _head(percentile: float) -> str:
    return f"p{percentile:g}"
