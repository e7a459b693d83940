"""Measured tip tracks: one run (tip and guide at each depth), the dataset of runs, and their selection."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Noise
from needlefit.errors import ConfigError
from needlefit.mechanics.needle import Needle
from needlefit.project.locate import join_names, sort_by_similarity
from needlefit.project.result_warnings import ResultWarning
from needlefit.schemas.study import TrackSelectionRecord

Floats = NDArray[np.float64]

GUIDE_STILL_MM = 0.05
"""A guide that moved by less than this, mm, counts as fixed: stages jitter."""


@dataclass(frozen=True)
class TipTrack:
    """One insertion of which the tip was measured at some depths; the first reading is first contact.

    Attributes
    ----------
    id, medium, specimen : str
        `specimen` is the piece punctured; runs into one piece are no independent ones.
    side : int
        The side that the bevel faces, +1: toward greater `tip`.
    depth : (n,) array
        Inserted length at each reading, mm, from 0.
    tip : (n,) array
        Lateral place of the tip in the tracker's frame, mm: known up to a shift and a slope.
    guide : (n,) array
        Lateral place of the guide on the way to each reading, mm, from where it stood at the first.
    boundaries, sequence : (m - 1,) array, m layer numbers
        Depths between the layers met, mm, and which layers of the medium they are.
    heading : (n,) array or None
        Direction of the tip as the tracker reports it, rad; kept, not fitted.
    """

    id: str
    medium: str
    specimen: str
    side: int
    depth: Floats
    tip: Floats
    guide: Floats
    boundaries: Floats
    sequence: tuple[int, ...]
    heading: Floats | None = None

    @property
    def guided(self) -> bool:
        """Whether the guide moved during the run."""
        return bool(np.ptp(self.guide) > GUIDE_STILL_MM)


@dataclass(frozen=True)
class TrackDataset:
    """Runs with one needle; `remarks` lists the runs left out, with reasons."""

    name: str
    title: str
    origin: Literal["measured", "synthetic"]
    needle: Needle
    tracks: tuple[TipTrack, ...]
    media: tuple[str, ...]
    noise: Noise
    path: Path
    digest: str
    notes: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    warnings: tuple[ResultWarning, ...] = ()


def select_runs(dataset: TrackDataset, wanted: TrackSelectionRecord) -> tuple[TipTrack, ...]:
    """Return the runs that match every key of `wanted`, in the dataset's order.

    Raises
    ------
    ConfigError
        If a medium or run is unknown, or none is left.
    """
    for kind, names, known in (
        ("medium", wanted.media, dataset.media),
        ("run", wanted.runs, tuple(track.id for track in dataset.tracks)),
    ):
        for name in names:
            if name not in known:
                raise ConfigError(
                    f"{kind} {name} is not in dataset {dataset.name}, or is left out",
                    expected=f"one of {join_names(sort_by_similarity(name, known))}",
                    fix="correct the selection",
                )
    chosen = tuple(track for track in dataset.tracks if _matches(track, wanted))
    if not chosen:
        raise ConfigError(
            f"no run of dataset {dataset.name} meets {wanted.model_dump(exclude_defaults=True)}",
            expected="a selection that leaves at least one",
            fix="widen or correct the selection",
        )
    return chosen


def _matches(track: TipTrack, wanted: TrackSelectionRecord) -> bool:
    return (
        (not wanted.media or track.medium in wanted.media)
        and (not wanted.runs or track.id in wanted.runs)
        and (wanted.guided is None or track.guided == wanted.guided)
    )
