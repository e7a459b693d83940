"""The answer of a study of tip tracks: tidy frames, and where they come from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import pandas as pd

from needlefit.inference.sampling.posterior import Posterior
from needlefit.project.records.track_study import TrackStudyRecord

RIVALS = ("fitted", "straight", "constant_curvature")

READINGS = (
    *("fit", "run", "medium", "rival", "depth_mm", "guide_mm", "scored", "measured_mm"),
    *("median_mm", "low_50_mm", "high_50_mm", "low_95_mm", "high_95_mm"),
)
"""A row per reading of a run foretold and rival; `measured_mm` counts from the run's first reading."""

RUNS = (
    *("fit", "role", "run", "medium", "specimen", "rival", "readings"),
    *("aligned_rms_mm", "rms_mm", "end_error_mm", "crps_mm", "end_width_95_mm"),
    *("end_in_50", "end_in_95", "track_level", "track_in_50", "track_in_95", "points_in_50", "points_in_95"),
)
"""A row per run and rival. `aligned_rms_mm` is what remains of the scored readings (all of them where the run
was fitted to) when the best shift and slope are taken from readings and draws, against the draws' median; the
rest is of what was foretold: error of the median, and at the last reading. `track_level` is the probability
foretold of a track nearer, at its worst reading, than the one seen."""

PARAMETERS = ("fit", "parameter", "p2_5", "p16", "p50", "p84", "p97_5", "contraction", "determined")
"""`contraction`: the draws' deviation over that of prior and bounds, in ln; 1: nothing was learned."""


@dataclass(frozen=True)
class TrackResults:
    """What one study of tip tracks found.

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
        Columns `READINGS`, `RUNS`, `PARAMETERS`.
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
        """What the study is called."""
        return self.record.title or self.name

    @property
    def faults(self) -> tuple[str, ...]:
        """Why a posterior has not converged, by fit; empty if all have."""
        return tuple(f"{name}: {fault}" for name, one in self.posteriors.items() for fault in one.faults)
