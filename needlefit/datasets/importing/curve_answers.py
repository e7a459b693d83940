"""Settle what is asked of every imported curve: an answer of each, the sides of their bevels, directions."""

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from scipy.spatial.transform import Rotation

from needlefit.arrays import Floats
from needlefit.datasets.importing.curves import ImportedCurve
from needlefit.datasets.importing.stated import Settler, Stated, name_set
from needlefit.datasets.insertion import Pose
from needlefit.datasets.layers import SAME_POINT_MM, select_layers
from needlefit.geometry.frames import to_unit
from needlefit.geometry.surfaces import Surface
from needlefit.project.locate import join_names

MIN_SAME_SIDE = 0.9  # smallest length of the mean of unit deflections that have one direction
SAME_AXIS_DEG = 10.0  # largest angle (degrees) to a world axis at which that axis is proposed

Answers = dict[ImportedCurve, Stated]  # of each needle
Numbers = dict[ImportedCurve, float]


def snap_to_axis(direction: Floats) -> Floats:
    """Return a unit direction, or the world axis that is near."""
    axis, nearest = np.zeros(3), int(np.argmax(np.abs(direction)))
    axis[nearest] = np.sign(direction[nearest])
    return axis if axis @ direction >= np.cos(np.radians(SAME_AXIS_DEG)) else direction


def format_direction(direction: Floats) -> str:
    """Return a direction as options state it."""
    return ",".join(f"{value:z.3g}" for value in direction.round(3))


def list_names(curves: Iterable[ImportedCurve]) -> str:
    """Return the names of curves, in a sentence; empty of none."""
    return join_names([curve.name for curve in curves], 5)


class BendsOfSides:
    """How far bevels of side 1 would have bent across their directions, mm: `toward` (N, 3).

    `bends` (N, 3): of curves, from the directions `along` (N, 3), mm.
    """

    def __init__(self, curves: Sequence[ImportedCurve], bends: Floats, along: Floats) -> None:
        turns = np.array([curve.turn for curve in curves])
        self.turned = Rotation.from_rotvec(turns[:, None] * along)
        across = bends - np.sum(bends * along, axis=1)[:, None] * along
        sides = np.array([curve.side for curve in curves])
        self.toward: Floats = sides[:, None] * self.turned.inv().apply(across)
        self.sizes = np.linalg.norm(self.toward, axis=1)
        self.units = self.toward / np.maximum(self.sizes, SAME_POINT_MM)[:, None]
        self.direction = to_unit(along.sum(axis=0))
        self.mean = to_unit(self.toward.sum(axis=0))  # of straight needles it is 0

    @property
    def agree(self) -> bool:
        """Whether they have one direction."""
        return bool(np.linalg.norm(self.units.sum(axis=0)) > MIN_SAME_SIDE * len(self.units))


class CurveAnswers:
    """Some curves of an import, and what holds of each; the `others` of the import stand beside them.

    `surfaces` part the layers of all.
    """

    def __init__(
        self,
        curves: list[ImportedCurve],
        settler: Settler,
        surfaces: list[Surface],
        others: Sequence[ImportedCurve] = (),
    ) -> None:
        self.curves, self.others, self.surfaces = curves, others, surfaces
        self.settler, self.assumed = settler, settler.assumed
        self.settle, self.note = settler.settle, settler.note

    def each(self, key: str, usual: str | None = None, reason: str = "", is_sure: bool = False) -> Answers:
        """Return what holds of each needle: its own cell, else the value of all.

        A value that is stated beside cells of all needles of the import takes their place. DataError if
        nothing states it of some needles.
        """
        cells = {curve: curve.stated[key] for curve in self.curves if key in curve.stated}
        missing = [curve for curve in self.curves if curve not in cells]
        is_stated = key in self.settler.values and not self.settler.is_partly_stated(key)
        if not cells or (is_stated and not missing):
            return dict.fromkeys(self.curves, self.settle(key, usual, reason, is_sure=is_sure))
        if not missing:
            return cells
        reason = f"stated of {list_names(cells)}, not of {list_names(missing)}"
        fix = f"fill in their cells, or state {name_set(key)} of all that are blank"
        rest = self.settle(key, "", reason, fix=fix, where=next(iter(cells.values())).where)
        return {curve: cells.get(curve, rest) for curve in self.curves}

    def numbers(
        self, key: str, is_above: bool = False, usual: str | None = None, reason: str = ""
    ) -> Numbers:
        """Return the number of each needle, in the unit of the key."""
        answers = self.each(key, usual, reason)
        return {curve: answer.to_number(key, is_above) for curve, answer in answers.items()}

    @property
    def point_sd_mm(self) -> float:
        """The least standard deviation of a point, mm, once they are settled."""
        return min(curve.point_sd for curve in self.curves)

    def stated(self, key: str) -> str:
        """Return what the mapping, or the same cell of every needle, states of all; empty if nothing."""
        shared = self.settler.find_shared(key)
        return shared.text if shared else self.settler.values.get(key, "")

    def is_stated(self, key: str) -> bool:
        """Return whether the mapping or the cells of a needle state a key."""
        return key in self.settler.values or any(key in curve.stated for curve in self.curves)

    def settle_sides(self, is_needed: bool = False) -> Numbers | None:
        """Return the direction that each bevel faces, degrees about the needle; None where nobody states it.

        Bevels that differ by half turns are of sides 1 and -1, all turned alike; others are of side 1.
        DataError if a cell is not understood. `is_needed`: what nobody states is assumed.
        """
        if not (is_needed or self.is_stated("bevel_side")):
            return None
        answers = self.each("bevel_side", "1", "not stated")
        angles = {curve: answer.to_angle() for curve, answer in answers.items()}
        period = 180.0 if len({angle % 180.0 for angle in angles.values()}) == 1 else 360.0
        for curve, angle in angles.items():
            curve.turn = float(np.radians(angle % period))
            curve.side = 1 if angle % 360.0 < period else -1
        return angles


class Placer(CurveAnswers):
    """Places the needles of one kind."""

    #: usual answers, with their reasons, of keys that are usual otherwise without such needles
    usual: Mapping[str, tuple[str | None, str]] = MappingProxyType({})
    pose: Pose = "known"
    #: of the direction of each run in the frame of a tracker, and of what all share; None: not known
    slope_sds_deg: tuple[float, float | None] = (0.0, None)

    def settle_places(self) -> None:
        """Settle entries and inserted lengths; `curves` may become others."""
        raise NotImplementedError

    def fill_rows(self) -> None:
        """Fill in the rows, but medium, specimen, needle and guide."""
        raise NotImplementedError

    def choose_study(self) -> Mapping[str, float | str]:
        """Return keys of a first study."""
        return {}

    def meet_layers(self, runs: Numbers | None = None) -> None:
        """Fill in the numbers of layers that needles meet, by the depths of boundaries.

        `runs`, mm: how far they go along their directions; without them their inserted lengths.
        """
        is_layered = bool(self.surfaces) or any(curve.boundaries for curve in self.curves)
        sds = self.numbers("boundary_sd") if is_layered else {}
        for curve in self.curves:
            reach = runs[curve] if runs else curve.depth
            _, layers = select_layers(np.array(curve.boundaries), reach)
            curve.fill(layers=len(layers), boundary_sd=sds.get(curve, 0.0))

    def settle_shifts(self) -> Numbers:
        """Settle the standard deviations of entries per axis, mm: usually that of a point."""
        return self.numbers("pose_shift_sd", usual=f"{self.point_sd_mm:g}", reason="that of a point")

    def note_deflections(self, zero: str = "from the line of insertion") -> None:
        """Note which deflections are positive, and from where they count, unless it is assumed."""
        if "deflection" not in self.assumed and any(curve.is_deflection for curve in self.curves):
            self.note("deflection", f"positive where a bevel of side 1 bends; {zero}")
