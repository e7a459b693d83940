"""The nouns of tracked tips: one run, and the dataset."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Noise
from needlefit.mechanics.needle import Needle
from needlefit.project.result_warnings import ResultWarning

Floats = NDArray[np.float64]

STANDS = 0.05
"""mm; a guide that moved less stood still: stages jitter."""


@dataclass(frozen=True)
class Track:
    """One insertion, of which the tip was read now and then; the first reading is first contact.

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
        """Whether the guide moved."""
        return bool(np.ptp(self.guide) > STANDS)


@dataclass(frozen=True)
class TrackDataset:
    """Runs with one needle; `remarks` says which runs of the table are left out, and why."""

    name: str
    title: str
    origin: Literal["measured", "synthetic"]
    needle: Needle
    tracks: tuple[Track, ...]
    media: tuple[str, ...]
    noise: Noise
    path: Path
    digest: str
    notes: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    warnings: tuple[ResultWarning, ...] = ()
