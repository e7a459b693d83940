"""Posteriors of a run: their files, and the table of percentiles."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from needlefit.inference.posterior import PERCENTILES, Posterior, save
from needlefit.validation.results import Results


def percentiles_table(results: Results) -> pd.DataFrame:
    """Return one row per fold and free parameter: percentiles (Pa, mm), R-hat, and the fold's acceptance.

    `converged` is false where R-hat or the length of the chains says that the percentiles are not final.
    """
    rows = [row for fold, posterior in results.posteriors.items() for row in _rows(fold, posterior)]
    heads = ("fold", "parameter", *map(_head, PERCENTILES), "r_hat", "acceptance", "converged", "origin")
    return pd.DataFrame([{**row, "origin": results.origin} for row in rows], columns=heads)


def posterior_files(results: Results) -> Mapping[str, Callable[[Path], object]]:
    """Return what `write` is to write besides: `posterior.csv`, and each fold's draws as netCDF."""
    if not results.posteriors:
        return {}
    single = len(results.posteriors) == 1
    draws = {
        "posterior.nc" if single else f"posterior_{number}.nc": partial(save, posterior)
        for number, posterior in enumerate(results.posteriors.values(), start=1)
    }
    table = percentiles_table(results)
    return {**draws, "posterior.csv": partial(table.to_csv, index=False, float_format="%.8g")}


def _rows(fold: str, posterior: Posterior) -> list[dict[str, object]]:
    about = {"acceptance": float(np.mean(posterior.acceptance)), "converged": posterior.converged}
    return [
        {
            "fold": fold,
            "parameter": name,
            **dict(zip(map(_head, PERCENTILES), values, strict=True)),
            "r_hat": float(posterior.r_hat[number]),
            **about,
        }
        for number, (name, values) in enumerate(posterior.percentiles().items())
    ]


def _head(percentile: float) -> str:
    return f"p{percentile:g}"
