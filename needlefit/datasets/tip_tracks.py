"""Measured tip tracks: insertions of which the tip was measured at some depths."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.geometry.frames import IDENTITY_FRAME

GUIDE_STILL_MM = 0.05  # a guide that moved by less than this, mm, counts as fixed: stages jitter


class TipReadings(NamedTuple):
    """The readings of a run; the first is first contact."""

    depth: Floats  # (n,); inserted length at each reading, mm, from 0
    tip: Floats  # (n,); lateral place of the tip in the tracker's frame, mm: known up to a shift and a slope
    # (n,); lateral place of the guide on the way to each reading, mm, from where it stood at the first.
    guide: Floats
    heading: Floats | None = None  # (n,); direction of the tip as the tracker reports it, rad


@dataclass(frozen=True, kw_only=True)
class TipTrack(Insertion):
    """An insertion that was observed by its tip on the way, not by its shape at the end.

    `planar` (n, 2) holds the depth and the tip of each reading, mm; `depth` is that of the last one. The
    `specimen` is the piece punctured; runs into one piece are no independent ones.
    """

    guide: Floats  # (n,)
    heading: Floats | None = None  # (n,); see `TipReadings`

    @property
    def depths(self) -> Floats:
        """Inserted length at each reading, (n,) mm."""
        return self.planar[:, 0]

    @property
    def tip(self) -> Floats:
        """Lateral place of the tip at each reading in the tracker's frame, (n,) mm."""
        return self.planar[:, 1]

    @property
    def guided(self) -> bool:
        """Whether the guide moved during the run."""
        return bool(np.ptp(self.guide) > GUIDE_STILL_MM)


def make_track(
    name: str,
    medium: str,
    specimen: str,
    side: int,
    readings: TipReadings,
    layers: tuple[Floats, tuple[int, ...]],
) -> TipTrack:
    """Return a run whose bevel faces `side` (+1: toward greater tip).

    `layers` are the boundaries (m - 1,), mm, and the m layer numbers between them.
    """
    boundaries, sequence = layers
    planar, flat = np.column_stack([readings.depth, readings.tip]), np.zeros(len(readings.depth))
    return TipTrack(
        id=name, medium=medium, specimen=specimen, layers=len(sequence), layers_alternative=len(sequence),
        depth=float(readings.depth[-1]), side=side, frame=IDENTITY_FRAME, pose_source="none",
        pose_shift_sd=0.0, pose_angle_sd=0.0, centerline=np.column_stack([planar, flat]), planar=planar,
        out_of_plane=flat, boundaries=boundaries, sequence=sequence, boundary_sd=0.0,
        guide=readings.guide, heading=readings.heading,
    )  # fmt: skip
