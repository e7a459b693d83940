"""The tables of a study of tip tracks, and their summaries."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
import pandas as pd
from scipy.stats import t as student

from needlefit.inference.baselines import BASELINES, list_baselines
from needlefit.inference.proportions import estimate_proportion
from needlefit.reporting.labels import method_name

READING_COLUMNS = (
    *("fit", "run", "medium", "method", "depth_mm", "guide_mm", "scored", "measured_mm"),
    *("median_mm", "low_50_mm", "high_50_mm", "low_95_mm", "high_95_mm"),
)
"""A row per reading of a run predicted and method; `measured_mm` counts from the run's first reading."""

RUN_COLUMNS = (
    *("fit", "role", "run", "medium", "specimen", "method", "readings"),
    *("aligned_rms_mm", "rms_mm", "end_error_mm", "crps_mm", "end_width_95_mm"),
    *("end_in_50", "end_in_95", "track_pit", "track_in_50", "track_in_95", "points_in_50", "points_in_95"),
)
"""A row per run and method. `aligned_rms_mm` is what remains of the scored readings (all of them where the
run was fitted to) when the best shift and slope are taken from readings and draws, against the draws' median;
the rest is of what was predicted: error of the median, and at the last reading. `track_pit` is the
probability predicted of a track nearer, at its worst reading, than the one seen."""

PARAMETER_COLUMNS = (
    *("fit", "parameter", "fitted", "p2_5", "p16", "p50", "p84", "p97_5", "sd_ratio"),
    *("determined", "condition", "note"),
)
"""`fitted`: at the posterior's mode. `sd_ratio`: the draws' deviation over that of prior and bounds, in ln;
1: nothing was learned. `condition`: the assumption under which alone the data determine a parameter."""


def list_track_methods() -> tuple[str, ...]:
    """Return the names of all methods that predict tracks: the fit, then baselines."""
    return ("fitted", *(one.name for one in list_baselines("tracks")))


def name_track_method(method: str) -> str:
    """Return the printed name of a method that predicts tracks; the model does with all draws."""
    if method == "fitted":
        return "fitted model"
    known = BASELINES.get(method)
    return known.track_label if known and known.track_label else method_name(method)


PAIRED_COLUMNS = (
    *("medium", "method", "metric", "runs", "value", "difference"),
    *("low", "high", "better"),
)
"""`difference_*`: the method's error minus the fitted model's, and its 95 % interval (Student) over runs."""

COVERAGE_COLUMNS = ("medium", "method", "quantity", "level", "covered", "runs", "specimens", "low", "high")
"""`low`, `high`: 95 % interval of the share; where `medium` is "all", of phantoms as trials."""

DEPTH_COLUMNS = ("medium", "method", "low_mm", "high_mm", "readings", "error_mm")
DEPTH_BIN_MM = 20.0
"""mm of depth that are taken together."""

FRAMES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "readings": READING_COLUMNS,
        "runs": RUN_COLUMNS,
        "parameters": PARAMETER_COLUMNS,
        "paired": PAIRED_COLUMNS,
        "coverage": COVERAGE_COLUMNS,
        "depths": DEPTH_COLUMNS,
    }
)

MEASURES = ("rms_mm", "aligned_rms_mm", "crps_mm")


def compare_methods_by_run(runs: pd.DataFrame) -> pd.DataFrame:
    """Compare every method with the fitted model on the same predicted runs: columns `PAIRED_COLUMNS`."""
    rows, held = [], runs[runs["role"] == "validate"]
    for medium, group in held.groupby("medium", sort=False):
        for measure in MEASURES:
            wide = group.pivot_table(index="run", columns="method", values=measure, sort=False)
            if "fitted" not in wide:  # its draws are not certified: no CRPS
                continue
            for method in [name for name in list_track_methods() if name in wide]:
                gap = (wide[method] - wide["fitted"]).to_numpy(dtype=np.float64)
                half = _half_width(gap)
                difference = (gap.mean(), gap.mean() - half, gap.mean() + half, int((gap > 0).sum()))
                rows.append((medium, method, measure, len(gap), wide[method].mean(), *difference))
    return pd.DataFrame(rows, columns=list(PAIRED_COLUMNS))


def tabulate_coverage(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the coverage of last-reading intervals and whole-track bands: columns `COVERAGE_COLUMNS`."""
    rows, held = [], runs[runs["role"] == "validate"].dropna(subset="track_pit")  # uncertified: no interval
    parts = [(str(medium), group) for medium, group in held.groupby("medium", sort=False)]
    for medium, group in [*parts, ("all", held)]:
        for method, some in group.groupby("method", sort=False):
            trials = some["specimen" if medium == "all" else "run"].tolist()
            for what in ("end", "track"):
                for level in (50, 95):
                    found = estimate_proportion(some[f"{what}_in_{level}"].tolist(), trials)
                    pieces = some["specimen"].nunique()
                    counted = (found.hits, found.trials, pieces, found.low, found.high)
                    rows.append((medium, method, what, level, *counted))
    return pd.DataFrame(rows, columns=list(COVERAGE_COLUMNS))


def tabulate_by_depth(readings: pd.DataFrame) -> pd.DataFrame:
    """Return the mean absolute error of the predicted medians by depth: columns `DEPTH_COLUMNS`."""
    scored = readings[readings["scored"].astype(bool)]
    scored = scored.assign(
        error_mm=(scored["median_mm"] - scored["measured_mm"]).abs(),
        low_mm=DEPTH_BIN_MM * np.floor(scored["depth_mm"] / DEPTH_BIN_MM),
    )
    grouped = scored.groupby(["medium", "method", "low_mm"], sort=False)["error_mm"]
    rows = grouped.agg(readings="size", error_mm="mean").reset_index()
    return rows.assign(high_mm=rows["low_mm"] + DEPTH_BIN_MM)[list(DEPTH_COLUMNS)]


def add_summaries(frames: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """Return readings, runs and parameters, and the tables that summarize them."""
    return {
        **frames,
        "paired": compare_methods_by_run(frames["runs"]),
        "coverage": tabulate_coverage(frames["runs"]),
        "depths": tabulate_by_depth(frames["readings"]),
    }


def _half_width(gap: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> float:
    """Return half of the 95 % interval of a mean of few differences; NaN of a single one."""
    n = len(gap)
    return float(student.ppf(0.975, n - 1) * gap.std(ddof=1) / np.sqrt(n)) if n > 1 else float("nan")
