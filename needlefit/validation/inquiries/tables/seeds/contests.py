"""The automatic fit against each rival on insertions held out, in pairs, with intervals over twins.

A pair is one insertion of one twin; its difference is the error of the fit less that of the rival. Insertions
of one twin share its specimens, needle and fit, so that they are not independent: twins are drawn with
replacement, and of each the insertions (a cluster bootstrap; `scipy.stats.bootstrap` knows one level only).
The interval is the middle 95 % of the means so drawn.
"""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from needlefit.project.streams import stream
from needlefit.validation.score import Row

Floats = NDArray[np.float64]

METRICS = ("ipe_mean_mm", "te_mm")
GROUP = ["study", "medium", "layers"]
CONTESTS = (
    *(*GROUP, "rival", "metric", "twins", "insertions"),
    *("fitted_mm", "rival_mm", "difference_mm", "low_mm", "high_mm", "floor_mm"),
    *("pairs_better", "twins_better", "verdict"),
)
"""`difference_mm` < 0: the fit errs less. `pairs_better`, `twins_better`: parts of the pairs, and number of
twins by their means, on which it does; `verdict` is "wins", "loses", or "open" where the interval holds 0."""


def contests(errors: pd.DataFrame, name: str, resamples: int) -> pd.DataFrame:
    """Return every contest of the fit on held-out insertions."""
    held_out = errors[errors["role"] == "validate"]
    return pd.DataFrame(_rows(held_out, name, resamples), columns=list(CONTESTS))


def _rows(held_out: pd.DataFrame, name: str, resamples: int) -> Iterator[Row]:
    for key, group in held_out.groupby(GROUP, sort=False):
        head = dict(zip(GROUP, key, strict=True))
        for metric in METRICS:
            table = by_twin(group, metric)
            floor = float(group.groupby("insertion")[f"floor_{metric}"].mean().mean())
            for rival in [one for one in table if one != "fitted"]:
                rng = stream(0, name, *map(str, key), rival, metric)
                row = _contest(table["fitted"], table[rival], resamples, rng)
                yield {**head, "rival": rival, "metric": metric, "floor_mm": floor, **row}


def by_twin(group: pd.DataFrame, metric: str) -> dict[str, Floats]:
    """Return the errors (S, n) of every rival on n insertions of S twins, mm; NaN where a solve failed."""
    wide = group.pivot_table(index="seed", columns=["rival", "insertion"], values=metric, sort=False)
    wide = wide.replace([np.inf], np.nan)
    return {rival: wide[rival].to_numpy(dtype=np.float64) for rival in group["rival"].unique()}


def _contest(fitted: Floats, rival: Floats, resamples: int, rng: np.random.Generator) -> Row:
    difference = fitted - rival  # (S, n)
    low, high = interval(difference, resamples, rng)
    means = np.nanmean(difference, axis=1)
    known = np.isfinite(difference)
    return {
        "twins": len(difference),
        "insertions": difference.shape[1],
        "fitted_mm": float(np.nanmean(fitted)),
        "rival_mm": float(np.nanmean(rival)),
        "difference_mm": float(np.nanmean(difference)),
        "low_mm": low,
        "high_mm": high,
        "pairs_better": float(np.mean(difference[known] < 0)),
        "twins_better": int((means < 0).sum()),
        "verdict": "wins" if high < 0 else "loses" if low > 0 else "open",
    }


def interval(values: Floats, resamples: int, rng: np.random.Generator) -> tuple[float, float]:
    """Return the 95 % interval of the mean of `values` (S, n), S clusters of n, by the cluster bootstrap."""
    clusters, members = values.shape
    twin = rng.integers(0, clusters, size=(resamples, clusters, 1))
    insertion = rng.integers(0, members, size=(resamples, clusters, members))
    means = np.nanmean(values[twin, insertion], axis=(1, 2))
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)
