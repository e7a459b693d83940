"""Scores of single runs, put together: rivals on the same runs, and how often intervals held.

Runs into one phantom share a fit, so an interval over them says what further runs into it would show, and no
more. Over several phantoms, each counts as one trial.
"""

import numpy as np
import pandas as pd
from scipy.stats import t as student

from needlefit.validation.coverage import share
from needlefit.validation.tracks.results import RIVALS, TrackResults

PAIRED = (
    *("medium", "rival", "measure", "runs", "mean_mm", "difference_mm"),
    *("difference_low_mm", "difference_high_mm", "better"),
)
"""`difference_*`: the rival's error minus the fitted model's, and its 95 % interval (Student) over runs."""

COVERAGE = ("medium", "rival", "what", "level", "held", "runs", "phantoms", "low", "high")
"""`low`, `high`: 95 % interval of the share; where `medium` is "all", of phantoms as trials."""

DEPTHS = ("medium", "rival", "from_mm", "to_mm", "readings", "error_mm")
STRETCH = 20.0
"""mm of depth that are taken together."""

MEASURES = ("rms_mm", "aligned_rms_mm", "crps_mm")


def paired_runs(results: TrackResults) -> pd.DataFrame:
    """Return how every rival compares with the fitted model on the same runs foretold: columns `PAIRED`."""
    rows, held = [], results.runs[results.runs["role"] == "validate"]
    for medium, group in held.groupby("medium", sort=False):
        for measure in MEASURES:
            wide = group.pivot_table(index="run", columns="rival", values=measure, sort=False)
            for rival in [name for name in RIVALS if name in wide]:
                gap = (wide[rival] - wide["fitted"]).to_numpy(dtype=np.float64)
                half = _half(gap)
                difference = (gap.mean(), gap.mean() - half, gap.mean() + half, int((gap > 0).sum()))
                rows.append((medium, rival, measure, len(gap), wide[rival].mean(), *difference))
    return pd.DataFrame(rows, columns=list(PAIRED))


def coverage(results: TrackResults) -> pd.DataFrame:
    """Return how often the intervals of the last reading, and the bands of whole tracks, held: `COVERAGE`."""
    rows, held = [], results.runs[results.runs["role"] == "validate"]
    parts = [(str(medium), group) for medium, group in held.groupby("medium", sort=False)]
    for medium, group in [*parts, ("all", held)]:
        for rival, some in group.groupby("rival", sort=False):
            trials = some["specimen" if medium == "all" else "run"].tolist()
            for what in ("end", "track"):
                for level in (50, 95):
                    found = share(some[f"{what}_in_{level}"].tolist(), trials)
                    pieces = some["specimen"].nunique()
                    counted = (found.hits, found.trials, pieces, found.low, found.high)
                    rows.append((medium, rival, what, level, *counted))
    return pd.DataFrame(rows, columns=list(COVERAGE))


def by_depth(results: TrackResults) -> pd.DataFrame:
    """Return the mean size of the error of the medians foretold, by stretches of depth: columns `DEPTHS`."""
    scored = results.readings[results.readings["scored"]]
    scored = scored.assign(
        error_mm=(scored["median_mm"] - scored["measured_mm"]).abs(),
        from_mm=STRETCH * np.floor(scored["depth_mm"] / STRETCH),
    )
    grouped = scored.groupby(["medium", "rival", "from_mm"], sort=False)["error_mm"]
    rows = grouped.agg(readings="size", error_mm="mean").reset_index()
    return rows.assign(to_mm=rows["from_mm"] + STRETCH)[list(DEPTHS)]


def _half(gap: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> float:
    """Return half of the 95 % interval of a mean of few differences; NaN of a single one."""
    n = len(gap)
    return float(student.ppf(0.975, n - 1) * gap.std(ddof=1) / np.sqrt(n)) if n > 1 else float("nan")
