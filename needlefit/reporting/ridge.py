"""The ridge on which a posterior lies: where parameters can move together and the needles stay what they are.

It is the longest principal axis of the draws, in logarithms of moduli and lengths; across it lies what the
data do tell.
"""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from needlefit.inference.identifiability.information import Direction, principal_directions
from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting.numbers import in_symbols
from needlefit.validation.results import Results

Floats = NDArray[np.float64]

LONG = 3.0
"""The longest axis of the draws is a ridge where it is so many times as long as the shortest."""

REACH = 2.0
"""Standard deviations to which the ridge is drawn on both sides."""


def draws_said(results: Results) -> str:
    """Return whose draws stand for the posterior, whether they can be trusted, and along what they lie."""
    fold = results.draws["fold"].iloc[0]
    draws = results.draws[results.draws["fold"] == fold]
    source, k, certified = (draws[name].iloc[0] for name in ("draw_source", "pareto_k", "certified"))
    said = f"{len(draws)} draws of the sampled posterior"
    if source == "importance":
        said = f"{len(draws)} draws weighed about the modes of the fit, Pareto k {k:.2f}".replace("-", "−")
    doubt = "" if certified else ", which is NOT CERTIFIED: sample it (--sample)"
    where = (
        f" Shown is the first of {results.draws['fold'].nunique()} folds, {fold}."
        if _several(results)
        else ""
    )
    return f"{said[:1].upper()}{said[1:]}{doubt}.{where} {_ridge_said(draws[free(results)])}"


def _ridge_said(draws: pd.DataFrame) -> str:
    """Return what is known across the ridge and what is not along it."""
    axes = axes_of(draws)
    if not is_ridge(axes):
        return "No pair lies on a ridge."
    known, loose = in_symbols(axes[0].words), in_symbols(axes[-1].words)
    return f"Dashed, the ridge: along it {loose}; across it {known}."


def _several(results: Results) -> bool:
    return bool(results.draws["fold"].nunique() > 1)


def free(results: Results) -> list[str]:
    """Return the parameters that were estimated."""
    known = results.parameters
    rows = known[(known["method"] == "fitted") & (known["status"] == "free")]
    return list(dict.fromkeys(rows["parameter"]))


def axes_of(draws: pd.DataFrame) -> tuple[Direction, ...]:
    """Return the principal axes of draws (Pa, mm), the shortest, which is known best, first."""
    names = [str(name) for name in draws.columns]
    spread = np.atleast_2d(np.cov(coordinates(draws), rowvar=False))
    information: Floats = np.linalg.pinv(spread, hermitian=True).astype(np.float64)
    return principal_directions(information, names)


def is_ridge(axes: tuple[Direction, ...]) -> bool:
    """Return whether draws with these axes lie along the longest."""
    return len(axes) > 1 and axes[-1].sd > LONG * axes[0].sd


def coordinates(values: pd.DataFrame) -> Floats:
    """Return values as theta has them (N, P): logarithms of moduli and lengths."""
    columns = [np.log(values[n]) if is_logarithmic(str(n)) else values[n] for n in values.columns]
    return np.column_stack([np.asarray(column, dtype=np.float64) for column in columns])


def ridge_ends(draws: pd.DataFrame) -> list[dict[str, float]]:
    """Return both ends of the ridge, Pa and mm; none where the draws have no longest axis."""
    axes = axes_of(draws)
    if not is_ridge(axes):
        return []
    middle, step = coordinates(draws).mean(axis=0), REACH * axes[-1].sd * np.array(axes[-1].weights)
    return [
        {
            str(name): float(np.exp(at) if is_logarithmic(str(name)) else at)
            for name, at in zip(draws.columns, end, strict=True)
        }
        for end in (middle - step, middle + step)
    ]
