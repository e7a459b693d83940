"""The result of a study of tip tracks: tidy tables, their summaries, and the file that stores them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from scipy.stats import t as student

from needlefit.inference.sampling.posterior import Posterior, load
from needlefit.project.input_files import convert_stored_errors
from needlefit.project.json_values import to_json_values
from needlefit.project.run_file import read_timing, require_schema
from needlefit.schemas.result_files import TracksTable
from needlefit.schemas.study import TrackStudyRecord
from needlefit.validation.packing import RESULTS_FILE, pack, pack_frame, unpack_frame
from needlefit.validation.proportions import estimate_proportion

METHODS = ("fitted", "straight", "constant_curvature")

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

PARAMETER_COLUMNS = ("fit", "parameter", "p2_5", "p16", "p50", "p84", "p97_5", "sd_ratio", "determined")
"""`sd_ratio`: the draws' deviation over that of prior and bounds, in ln; 1: nothing was learned."""


@dataclass(frozen=True)
class TrackResults:
    """The result of one study of tip tracks.

    Attributes
    ----------
    name : str
        Of the study's file.
    record : TrackStudyRecord
        What was asked for.
    origin : str
        "measured" or "synthetic".
    dataset_title : str
    notes, remarks : tuples of str
        What the data's makers want known, and which runs are left out.
    readings, runs, parameters : DataFrame
        Columns `READING_COLUMNS`, `RUN_COLUMNS`, `PARAMETER_COLUMNS`.
    posteriors : mapping
        By fit.
    run : dict
        Versions, seeds, digests, configuration, model rules: no time, no path.
    timing : dict
    interrupted : bool
    """

    name: str
    record: TrackStudyRecord
    origin: Literal["measured", "synthetic"]
    dataset_title: str
    notes: tuple[str, ...]
    remarks: tuple[str, ...]
    readings: pd.DataFrame
    runs: pd.DataFrame
    parameters: pd.DataFrame
    run: dict[str, Any]
    timing: dict[str, Any]
    interrupted: bool
    posteriors: Mapping[str, Posterior] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """The title of the study."""
        return self.record.title or self.name

    @property
    def faults(self) -> tuple[str, ...]:
        """Why a posterior has not converged, by fit; empty if all have."""
        return tuple(f"{name}: {fault}" for name, one in self.posteriors.items() for fault in one.faults)


TRACKS_KIND = "tracks"

_PLAIN = ("name", "origin", "dataset_title", "interrupted", "run")
_TUPLES = ("notes", "remarks")
_FRAMES = ("readings", "runs", "parameters")


def posterior_file(fit: str) -> str:
    """Return the name of the posterior file of one fit."""
    return f"posterior-{fit}.nc"


def store_tracks(results: TrackResults, folder: Path) -> Path:
    """Write `results` without posteriors and times to `folder`; equal results give equal bytes."""
    table = {key: to_json_values(getattr(results, key)) for key in _PLAIN}
    table |= {key: list(getattr(results, key)) for key in _TUPLES}
    table["record"] = results.record.model_dump(mode="json", by_alias=True)
    table["posteriors"] = list(results.posteriors)
    frames = {key: pack_frame(getattr(results, key)) for key in _FRAMES}
    return pack({"kind": TRACKS_KIND, **table, "frames": frames}, folder)


def restore_tracks(table: Mapping[str, Any], folder: Path) -> TrackResults:
    """Read the results that a run stored as `table` in `folder`; DataError if it is damaged."""
    require_schema(table, TracksTable, str(folder / RESULTS_FILE))
    about: dict[str, Any] = {key: table[key] for key in _PLAIN}
    about |= {key: tuple(table[key]) for key in _TUPLES}
    with convert_stored_errors(folder / RESULTS_FILE):
        about |= {key: unpack_frame(table["frames"][key]) for key in _FRAMES}
        return TrackResults(
            record=TrackStudyRecord.model_validate(table["record"]),
            timing=read_timing(folder),
            posteriors={fit: load(folder / posterior_file(fit)) for fit in table["posteriors"]},
            **about,
        )


PAIRED_COLUMNS = (
    *("medium", "method", "measure", "runs", "mean_mm", "difference_mm"),
    *("difference_low_mm", "difference_high_mm", "better"),
)
"""`difference_*`: the method's error minus the fitted model's, and its 95 % interval (Student) over runs."""

COVERAGE_COLUMNS = ("medium", "method", "quantity", "level", "covered", "runs", "phantoms", "low", "high")
"""`low`, `high`: 95 % interval of the share; where `medium` is "all", of phantoms as trials."""

DEPTH_COLUMNS = ("medium", "method", "from_mm", "to_mm", "readings", "error_mm")
DEPTH_BIN_MM = 20.0
"""mm of depth that are taken together."""

MEASURES = ("rms_mm", "aligned_rms_mm", "crps_mm")


def compare_methods_by_run(results: TrackResults) -> pd.DataFrame:
    """Compare every method with the fitted model on the same predicted runs: columns `PAIRED_COLUMNS`."""
    rows, held = [], results.runs[results.runs["role"] == "validate"]
    for medium, group in held.groupby("medium", sort=False):
        for measure in MEASURES:
            wide = group.pivot_table(index="run", columns="method", values=measure, sort=False)
            for method in [name for name in METHODS if name in wide]:
                gap = (wide[method] - wide["fitted"]).to_numpy(dtype=np.float64)
                half = _half_width(gap)
                difference = (gap.mean(), gap.mean() - half, gap.mean() + half, int((gap > 0).sum()))
                rows.append((medium, method, measure, len(gap), wide[method].mean(), *difference))
    return pd.DataFrame(rows, columns=list(PAIRED_COLUMNS))


def tabulate_coverage(results: TrackResults) -> pd.DataFrame:
    """Return the coverage of last-reading intervals and whole-track bands: columns `COVERAGE_COLUMNS`."""
    rows, held = [], results.runs[results.runs["role"] == "validate"]
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


def tabulate_by_depth(results: TrackResults) -> pd.DataFrame:
    """Return the mean absolute error of the predicted medians by depth: columns `DEPTH_COLUMNS`."""
    scored = results.readings[results.readings["scored"]]
    scored = scored.assign(
        error_mm=(scored["median_mm"] - scored["measured_mm"]).abs(),
        from_mm=DEPTH_BIN_MM * np.floor(scored["depth_mm"] / DEPTH_BIN_MM),
    )
    grouped = scored.groupby(["medium", "method", "from_mm"], sort=False)["error_mm"]
    rows = grouped.agg(readings="size", error_mm="mean").reset_index()
    return rows.assign(to_mm=rows["from_mm"] + DEPTH_BIN_MM)[list(DEPTH_COLUMNS)]


def _half_width(gap: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> float:
    """Return half of the 95 % interval of a mean of few differences; NaN of a single one."""
    n = len(gap)
    return float(student.ppf(0.975, n - 1) * gap.std(ddof=1) / np.sqrt(n)) if n > 1 else float("nan")
