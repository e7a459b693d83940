"""Where a needle that bends in a plane lies in space."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needlefit.geometry.frames import Frame
from needlefit.geometry.patient import IN_PATIENT
from needlefit.schemas.recording import PlacementRecord

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Placement:
    """The constraint frame C and the patient coordinates of the scan, each in the world.

    Attributes
    ----------
    frame : Frame
        C; the needle lies in its xy plane.
    patient : Frame
        LPS.
    """

    frame: Frame
    patient: Frame = IN_PATIENT

    @classmethod
    def from_record(cls, record: PlacementRecord) -> Self:
        """Return the placement that a checked record says."""
        return cls(Frame.from_rows(record.entry_to_world), Frame.from_rows(record.lps_to_world))

    def to_record(self) -> PlacementRecord:
        """Return it as files hold it; reading it gives the same bits."""
        return PlacementRecord(
            entry_to_world=self.frame.rows.tolist(), lps_to_world=self.patient.rows.tolist()
        )

    @property
    def across(self) -> Floats:
        """C's y axis in the patient coordinates, (3,)."""
        found: Floats = self.frame.rotation[:, 1] @ self.patient.rotation
        return found

    def to_world(self, points: ArrayLike) -> Floats:
        """Return points (K, 2) of C in the world, (K, 3) mm."""
        flat = np.asarray(points, dtype=np.float64)
        return self.frame.to_world(np.column_stack([flat, np.zeros(len(flat))]))

    def to_patient(self, points: ArrayLike) -> Floats:
        """Return points (K, 2) of C in the patient coordinates, (K, 3) LPS, mm."""
        return self.patient.to_local(self.to_world(points))


def carried(frame: Frame, points: Floats, to: Floats) -> Frame:
    """Return the frame in which `points` (K, 2) lie where those of `to` (K, 2) lie in `frame`.

    Both are the same points, moved rigidly in the plane.
    """
    start, end = (complex(*(curve[-1] - curve[0])) for curve in (points, to))
    turn = end / start / abs(end / start)
    rotation = np.array([[turn.real, -turn.imag, 0.0], [turn.imag, turn.real, 0.0], [0.0, 0.0, 1.0]])
    shift = to[0] - rotation[:2, :2] @ points[0]
    return Frame(frame.to_world([[*shift, 0.0]])[0], frame.rotation @ rotation)
