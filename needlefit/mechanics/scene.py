"""A scene: everything that one simulation needs, and where it stands in the world."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needlefit.mechanics.control import Bevel, Controls, Guide, Rules
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.tissue import Tissue
from needlefit.project.records.scene import ControlsRecord, EntryRecord, SceneRecord

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Entry:
    """The tip's pose in the world at first contact, an element of SE(2): C's origin (mm) and x axis (rad)."""

    x: float = 0.0
    y: float = 0.0
    angle: float = 0.0

    @classmethod
    def from_record(cls, record: EntryRecord) -> Self:
        """Return the pose that a checked record describes."""
        return cls(record.x_mm, record.y_mm, math.radians(record.angle_deg))

    def to_world(self, points: ArrayLike) -> Floats:
        """Return points (K, 2) of C in the world, mm."""
        cos, sin = math.cos(self.angle), math.sin(self.angle)
        x, y = np.asarray(points, dtype=np.float64).T  # (K,)
        return np.column_stack((self.x + cos * x - sin * y, self.y + sin * x + cos * y))


@dataclass(frozen=True)
class Scene:
    """The arguments of `simulate`, and the entry's pose.

    Attributes
    ----------
    depth : float
        Inserted arc length, mm.
    entry : Entry
        C in the world.
    """

    needle: Needle
    tissue: Tissue
    bevel: Bevel
    depth: float
    controls: Controls = Controls()
    rules: Rules = Rules()
    entry: Entry = Entry()

    @classmethod
    def from_record(cls, record: SceneRecord) -> Self:
        """Return the scene that a checked record describes."""
        return cls(
            needle=Needle.from_record(record.needle),
            tissue=Tissue.from_records(record.layers, record.law),
            bevel=Bevel.from_record(record.bevel),
            depth=record.depth_mm,
            controls=_controls(record.controls),
            rules=Rules.from_record(record.rules),
            entry=Entry.from_record(record.entry),
        )


def _controls(record: ControlsRecord) -> Controls:
    """Return the controls that a checked record describes (degrees become slopes)."""
    guides = () if record.guide_distance_mm is None else (Guide(-record.guide_distance_mm),)
    return Controls(record.base_y_mm, math.tan(math.radians(record.base_slope_deg)), guides=guides)
