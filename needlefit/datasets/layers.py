"""Find the layers of each insertion and reduce it to its plane; faults of curves, surfaces and layers."""

import math
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import NamedTuple

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import InsertionRow, describe_column
from needlefit.datasets.faults import Fault
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.observations import HELD
from needlefit.datasets.points import MIN_POINTS, Points
from needlefit.errors import DataError
from needlefit.geometry.crossings import find_crossings
from needlefit.geometry.curves import find_bending_direction, fit_free_frame
from needlefit.geometry.frames import Frame, make_entry_frame
from needlefit.geometry.penalized_spline import fit_penalized_spline
from needlefit.geometry.smoothing_spline import SplineSections
from needlefit.geometry.stray_points import find_stray_points
from needlefit.geometry.surfaces import Surface, find_mesh_faults, read_surface
from needlefit.mechanics.needle import Needle
from needlefit.project.input_files import is_file
from needlefit.project.toml import locate_key
from needlefit.project.unit_warnings import LENGTH_UNITS, FormatPlace
from needlefit.schemas.dataset import DatasetRecord, SurfaceRecord

MIN_SURFACE_MM = 1.0  # smallest extent of a surface (mm); a smaller one was written in another unit
MAX_SURFACE_MM = 2000.0  # largest extent of a surface (mm); a larger one was written in another unit
RESTORE_FIX = "check its name, or restore it"
EXPORT_FIX = "export the surface again as triangles, e.g. as STL"
MISSED_FIX = "export surfaces and centrelines in mm and in one frame (LPS or RAS)"


@dataclass(frozen=True)
class Medium:
    """The layers that one insertion can meet: surfaces in the world, or depths along the needle."""

    surfaces: tuple[Surface, ...] = ()
    boundaries: Floats | None = None


# The surfaces that all insertions share; None: it has a fault, which is noted.
SharedSurfaces = Mapping[SurfaceRecord, Surface | None]


def read_shared_surfaces(record: DatasetRecord, folder: Path, faults: list[Fault]) -> SharedSurfaces:
    """Read the surfaces of all media that insertions share; note their faults."""
    listed = [surface for medium in record.media.values() for surface in medium.surfaces]
    return {
        surface_record: _read_surface(surface_record, folder / surface_record.file, faults)
        for surface_record in listed
        if not surface_record.own
    }


def make_medium(
    row: InsertionRow, record: DatasetRecord, folder: Path, shared: SharedSurfaces, faults: list[Fault]
) -> Medium | None:
    """Return an insertion's medium, surfaces in its `folder` in place of shared ones; None after a fault."""
    medium = record.media[row.medium]
    depths = medium.boundaries_mm if row.boundaries is None else row.boundaries
    surfaces = [
        _read_surface(surface_record, folder / surface_record.file_of(row.id), faults)
        if surface_record.own
        else shared[surface_record]
        for surface_record in medium.surfaces
    ]
    sound = tuple(surface for surface in surfaces if surface is not None)
    boundaries = None if depths is None else np.array(depths, dtype=np.float64)
    return Medium(sound, boundaries) if len(sound) == len(surfaces) else None


def _read_surface(record: SurfaceRecord, path: Path, surface_faults: list[Fault]) -> Surface | None:
    try:
        surface = read_surface(path, record.kind, record.into)
    except DataError as error:
        fault = make_file_fault(error, path)
        if fault not in surface_faults:  # two media may share a surface
            surface_faults.append(fault)
        return None
    faults = list(find_surface_faults(surface, path))
    surface_faults += [fault for fault in faults if fault not in surface_faults]
    return None if faults else surface


def make_file_fault(error: DataError, path: Path) -> Fault:
    """Return the fault of a surface file that could not be read, with its fix."""
    return error if error.fix else error.replace(fix=EXPORT_FIX if is_file(path) else RESTORE_FIX)


def find_surface_faults(surface: Surface, path: Path) -> Iterator[Fault]:
    """Yield the reasons why the surface in a file cannot be a layer boundary; lengths in mm."""
    expected = {
        "solid": "a closed surface in one piece, triangles outward",
        "sheet": "one piece with one rim, larger than the tissue it parts",
    }[surface.kind]
    for mesh_fault in find_mesh_faults(surface):
        yield DataError(
            f"the {surface.kind} {mesh_fault}",
            expected=expected,
            fix="fix the mesh (e.g. MeshLab, Slicer)",
            where=path,
        )
    extent = float(np.ptp(surface.vertices, axis=0).max())
    if not MIN_SURFACE_MM <= extent <= MAX_SURFACE_MM:
        yield DataError(
            f"is {extent:.3g} mm across",
            expected=f"{MIN_SURFACE_MM:g} to {MAX_SURFACE_MM:g} mm",
            fix="convert its coordinates to mm",
            where=path,
        )


# opening of an open mesh over its area below which it is a solid with a hole rather than a sheet: a plane has
# 1, half a ball 1 / 2, a cube without a face 1 / 5
MAX_OPENING_RATIO = 0.25


def find_hole(surface: Surface, path: Path, fix: str) -> Iterator[Fault]:
    """Yield the fault of an open mesh that looks like a solid with a hole.

    The vectors of its triangles' areas add up to that of its opening, whatever the mesh does between.
    """
    opening = float(np.linalg.norm(surface.areas.sum(axis=0)))
    area = float(np.linalg.norm(surface.areas, axis=1).sum())
    if opening < MAX_OPENING_RATIO * area:
        sizes = f"its opening, {opening:.0f} mm^2, is small against its area, {area:.0f} mm^2"
        yield DataError(
            f"is open, but {sizes}: it looks like a solid with a hole",
            expected="a closed surface, or a sheet with its rim outside the tissue",
            fix=fix,
            where=path,
        )


def find_layers(
    centerline: Floats, frame: Frame, surfaces: Sequence[Surface]
) -> tuple[Floats, tuple[int, ...]]:
    """Return the depths (n - 1,) along C's x at which a centreline (N, 3) crosses surfaces, and n layers."""
    crossed = find_crossings(centerline, surfaces)
    return compute_depths(crossed.points, frame), crossed.sequence


def compute_depths(points: Floats, frame: Frame) -> Floats:
    """Return the depths (..., m) along C's x of crossings (..., m, 3), in order along the needle, mm."""
    x = frame.to_local(points)[..., 0]
    # the centreline's first point is not exactly the entry: an interface there may project before it
    return np.maximum.accumulate(np.maximum(x, 0.0), axis=-1)


def select_layers(boundaries: Floats, reach: float) -> tuple[Floats, tuple[int, ...]]:
    """Return the given depths that lie before `reach`, (n - 1,), mm, and the n layers met."""
    depths = boundaries[boundaries < reach]
    return depths, tuple(range(1, len(depths) + 2))


def reduce_insertion(
    row: InsertionRow,
    points: Points,
    medium: Medium,
    needle: Needle,
    patient: Frame,
    sections: SplineSections | None = None,
) -> Insertion:
    """Reduce a row without faults to an insertion in its bending plane; `patient` is the pose of its scan in
    the world.

    C stands at the entry pose; its plane is that of `row.bevel`, or, where that is empty, the one in which
    the centreline leaves the entry line; where a roll is stated, y points where the bevel faces at first
    contact. A row without entry pose gets `fit_free_frame`. DataError if the bevel direction is parallel to
    the entry.
    """
    centerline = points.values
    frame = _make_frame(row, points)
    local = frame.to_local(centerline)
    if medium.boundaries is None:
        boundaries, sequence = find_layers(points.curve.smoothed, frame, medium.surfaces)
    else:
        reach = row.depth if row.entry is None else float(local[-1, 0])
        boundaries, sequence = select_layers(medium.boundaries, reach)
    names = {field.name for field in fields(Insertion)} & {field.name for field in fields(InsertionRow)}
    given = {name: getattr(row, name) for name in names}
    contact = row.roll if row.roll is not None else 0.0 if row.side > 0 else math.pi
    given["layers_alternative"] = row.layers if row.layers_alternative is None else row.layers_alternative
    return Insertion(
        **given
        | {
            "frame": frame,
            "centerline": centerline,
            "points": local,
            "needle": needle,
            "boundaries": boundaries,
            "sequence": sequence,
            "sd": points.sd,
            "surfaces": medium.surfaces,
            "patient": patient,
            "sections": sections,
            "side": row.side if row.roll is None else 1,
            "turns": tuple((depth, math.degrees(roll - contact)) for depth, roll in row.turns),
            "curvature": _turn_curvature(row),
            "observation": row.observation or "points",
            "tip": _select_tip(row),
            "curves": {"space": (local, points.curve.to_local(frame))},
        }
        | (HELD[row.observation].attributes(row) if row.observation in HELD else {})
    )


def _select_tip(row: InsertionRow) -> Floats | None:
    """Return the tip (3,) beside a shape, as `Insertion.tip`; None where there is none."""
    if row.tip_y is None:
        return None
    return np.array([row.tip_y, *(np.nan if one is None else one for one in (row.tip_z, row.tip_sd))])


def _make_frame(row: InsertionRow, points: Points) -> Frame:
    centerline = points.values
    if row.entry is None or row.direction is None:
        frame = fit_free_frame(centerline)
        # a shape bends toward its bevel
        return frame if row.side > 0 else Frame(frame.origin, frame.rotation * [1.0, -1.0, -1.0])
    before = centerline  # the first turn, if there is any: behind it the needle bends elsewhere
    if row.turns:
        before = centerline[: max(2, int(np.searchsorted(points.curve.s, row.turns[0][0])))]
    toward = find_bending_direction(before, row.direction) if row.bevel is None else row.bevel
    frame = make_entry_frame(row.entry, row.direction, toward)
    if row.roll is None:
        return frame
    (x, y, z), (cos, sin) = frame.rotation.T, (math.cos(row.roll), math.sin(row.roll))
    return make_entry_frame(row.entry, x, cos * y + sin * z)


def _turn_curvature(row: InsertionRow) -> Floats | None:
    """Return the curvatures along y and z of C, where these were turned to the bevel at first contact."""
    if row.curvature is None or row.roll is None:
        return row.curvature
    cos, sin = math.cos(row.roll), math.sin(row.roll)
    s, y, z, sd = row.curvature.T
    return np.column_stack([s, cos * y + sin * z, cos * z - sin * y, sd])


# distance (mm) by which any centreline may go back: noise does that where points are dense
MAX_BACKWARD_MM = 0.05
MAX_BACKWARD_SD = 8.0  # distance by which a centreline may go back, in deviations of its noise
MAX_BACKWARD_PART = 0.1  # largest such distance, as a fraction of the centreline's span
SAME_POINT_MM = 1e-6  # distance (mm) below which two points are one
# allowed difference between length and depth, over the depth; a free shape need not begin at the entry
LENGTH_TOLERANCE = {"known": 0.05, "free": 0.30}
LENGTH_TOLERANCE_MM = 2.0  # allowed difference (mm) where that is smaller
# smallest depth (mm) of a needle's deepest insertion; a smaller one was written in another unit
MIN_DEEPEST_MM = 10.0
MAX_START_DISTANCE_MM = 5.0  # largest distance (mm) of a centreline's first point from the entry pose
# smallest cosine between the entry direction and that from the entry to points ahead of it
AHEAD_COSINE = 0.98
MAX_HEADING_DEG = 45.0  # largest angle (degrees) between the entry direction and the chord of the centreline
# relative difference of a curve's span from the depth below which another unit explains their ratio
UNIT_TOLERANCE = 0.25


def find_length_tolerance(depth: float, pose: str = "known") -> float:
    """Return by how much the length of a curve may differ from its stated depth, mm."""
    return max(LENGTH_TOLERANCE_MM, LENGTH_TOLERANCE[pose] * depth)


def find_curve_faults(
    points: Points, row: InsertionRow, record: DatasetRecord, place: str
) -> Iterator[Fault]:
    """Yield the faults of enough finite points as the centreline of `row`; `place` is used in messages."""
    curve = points.values
    depth_mm = describe_column(record.insertions.columns, "depth_mm")
    if (stray := find_stray_fault(points)) is not None:
        yield stray
        return  # the length is wrong as well
    # The point farthest from the mean is one end, also of an unsorted curve; the other end is the point
    # farthest from it.
    end = curve[np.argmax(np.linalg.norm(curve - curve.mean(axis=0), axis=1))]
    span = max(float(np.linalg.norm(curve - end, axis=1).max()), SAME_POINT_MM)
    back = find_backward_points(points.values)
    for name, factor in LENGTH_UNITS.items() if not len(back) else ():  # else its length is not its span
        of_points = abs(span * factor / row.depth - 1) < UNIT_TOLERANCE
        if of_points or abs(factor * row.depth / span - 1) < UNIT_TOLERANCE:
            yield DataError(
                f"{depth_mm} is {row.depth:.4g}, and the centreline spans {span:.4g}: "
                f"{'the centreline' if of_points else depth_mm} looks like {name}",
                expected="millimetres",
                fix=f"look at its unit; in millimetres it would be {factor:g} times as much",
                where=points.where() if of_points else place,
            )
            return  # every other length is wrong as well
    steps = np.diff(points.values, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    repeated = np.flatnonzero(lengths < SAME_POINT_MM)
    if len(repeated):
        yield DataError(
            f"repeats the point before it{_describe_more(len(repeated))}",
            expected="points that differ",
            fix="remove the repeated points",
            where=points.where(int(repeated[0]) + 1),
        )
    if len(back):
        yield make_order_fault(points, back)
    if row.entry is not None and row.direction is not None:
        yield from _find_entry_faults(points, row.entry, row.direction)


def find_stray_fault(points: Points) -> Fault | None:
    """Return the fault of single points that lie far from all others, which are in order."""
    stray = find_stray_points(points.values)
    if not len(stray) or len(find_backward_points(np.delete(points.values, stray, axis=0))):
        return None
    return DataError(
        f"lies far from all other points{_describe_more(len(stray))}",
        expected="points along the needle",
        fix="compare it with its source, or remove it",
        where=points.where(int(stray[0])),
    )


def make_order_fault(points: Points, back: np.ndarray) -> Fault:
    """Return the fault of points that go `back` along their curve."""
    return DataError(
        f"has points out of order: from here they go back{_describe_more(len(back))}",
        expected="points in order from the entry to the tip",
        fix="sort the points, and remove branches and loops",
        where=points.where(int(back[0])),
    )


def find_backward_points(curve: Floats) -> np.ndarray:
    """Return the points that lie behind an earlier one, along the chord or along the step before."""
    chord = curve[-1] - curve[0]
    along = curve @ (chord / max(float(np.linalg.norm(chord)), SAME_POINT_MM))
    steps = np.diff(curve, axis=0)
    headings = steps / np.maximum(np.linalg.norm(steps, axis=1), SAME_POINT_MM)[:, None]
    # Two criteria: along the chord finds swapped parts of a curve, along the step before finds a fold.
    back = np.maximum.accumulate(along) - along
    back[2:] = np.maximum(back[2:], -np.einsum("ij,ij->i", steps[1:], headings[:-1]))
    if back.max() <= MAX_BACKWARD_MM:  # whatever the noise
        return np.empty(0, dtype=np.int64)
    return np.flatnonzero(back > _find_backward_tolerance(curve, along))


def _find_backward_tolerance(curve: Floats, along: Floats) -> float:
    """Return by how much noise may put a point behind an earlier one, mm.

    The noise is that about a smooth curve over the places `along` the chord: the order of points, which is in
    question, is not used.
    """
    span = float(np.ptp(along))
    if len(np.unique(along)) < MIN_POINTS:
        return MAX_BACKWARD_MM
    noise_sd = fit_penalized_spline((along - along.min()) / span, curve, curve.shape[1] - 1).noise_sd
    return max(MAX_BACKWARD_MM, min(MAX_BACKWARD_SD * noise_sd, MAX_BACKWARD_PART * span))


def _describe_more(count: int) -> str:
    return f" (and at {count - 1} more)" if count > 1 else ""


def _find_entry_faults(points: Points, entry: Floats, direction: Floats) -> Iterator[Fault]:
    first, last = points.values[0], points.values[-1]
    off = float(np.linalg.norm(first - entry))
    if off > MAX_START_DISTANCE_MM:
        how, fix = "", "bring pose and centreline into one frame (LPS, RAS?)"
        if np.linalg.norm(last - entry) < off:
            how, fix = ": it seems to run from tip to entry", "reverse the points"
        elif (first - entry) @ direction > AHEAD_COSINE * off:
            how, fix = (
                ", along the entry direction",
                "check the entry, and whether first points are missing",
            )
        yield DataError(
            f"begins {off:.2f} mm from the entry pose{how}",
            expected=f"the entry first, within {MAX_START_DISTANCE_MM:g} mm of it",
            fix=fix,
            where=points.where(),
        )
        return
    chord = last - first
    cosine = float(chord @ direction / max(float(np.linalg.norm(chord)), SAME_POINT_MM))
    if cosine < np.cos(np.radians(MAX_HEADING_DEG)):
        yield DataError(
            f"runs {np.degrees(np.arccos(np.clip(cosine, -1, 1))):.0f} degrees off the entry direction",
            expected=f"at most {MAX_HEADING_DEG:g} degrees",
            fix="point entry_dx, _dy, _dz into the tissue, in the centreline's frame (LPS, RAS?)",
            where=points.where(),
        )


@dataclass(frozen=True)
class ListedInsertion:
    """An insertion, its row, the line of it in the table, and its points as they were read.

    `is_curve`: whether these are a measured shape, or stand for a tip, or for curvatures.
    """

    insertion: Insertion
    row: InsertionRow
    where: str
    points: Points
    is_curve: bool = True


class Checked(NamedTuple):
    """A dataset without faults, which checks look through for what contradicts it."""

    record: DatasetRecord
    listed: Sequence[ListedInsertion]
    noise: Noise
    where: FormatPlace  #: the key of a value -> file and key
    assumed: Container[str] = ()  #: keys of what the import assumed

    @property
    def insertions(self) -> list[Insertion]:
        """What is listed, as insertions."""
        return [entry.insertion for entry in self.listed]

    @property
    def curves(self) -> list[ListedInsertion]:
        """Those of which a shape was measured."""
        return [entry for entry in self.listed if entry.is_curve]


def find_length_faults(listed: Sequence[ListedInsertion], pose: str, depth_column: str) -> Iterator[Fault]:
    """Yield a fault for each curve that is far from as long as its depth."""
    for entry in listed:
        length, depth = entry.insertion.smooth("space").length, entry.insertion.depth
        limit = find_length_tolerance(depth, pose)
        if abs(length - depth) > limit:
            yield DataError(
                f"is {length:.2f} mm long, but `{depth_column}` is {depth:.2f}",
                expected=f"the inserted length, within {limit:.1f} mm",
                fix="check the depth, and the order of the points",
                where=entry.points.where(),
            )


def find_media_faults(record: DatasetRecord, file: Path) -> Iterator[Fault]:
    """Return the media that skip a layer number: a mistyped `into`, or a missing surface."""
    for name, medium in record.media.items():
        numbers = {surface.into for surface in medium.surfaces}
        skipped = sorted(set(range(2, max(numbers, default=1))) - numbers)
        if skipped:
            listed = ", ".join(map(str, sorted(numbers)))
            yield DataError(
                f"no surface of medium {name} leads into layer {skipped[0]}; they lead into {listed}",
                expected="layers numbered 1, 2, 3, ... without a gap",
                fix="correct `into`, or add the surface that is missing",
                where=locate_key(file, f"media.{name}.surfaces"),
            )


def find_layer_faults(
    listed: Sequence[ListedInsertion], record: DatasetRecord, file: Path
) -> Iterator[Fault]:
    """Return the insertions that do not meet their listed layers, and surfaces that are listed twice."""
    for name in dict.fromkeys(entry.insertion.medium for entry in listed):
        group = [entry for entry in listed if entry.insertion.medium == name]
        files = [surface_record.file for surface_record in record.media[name].surfaces]
        if len({*files}) < len(files):
            yield DataError(
                f"medium {name} lists a surface twice: {', '.join(files)}",
                expected="a surface of its own for every boundary",
                fix="name the right file, or remove one",
                where=locate_key(file, f"media.{name}.surfaces"),
            )
            continue
        faults = [fault for entry in group for fault in _find_count_fault(entry)]
        deepest = max((insertion.insertion for insertion in group), key=lambda insertion: insertion.depth)
        if faults and (unit := name_small_unit(deepest)):
            yield DataError(
                f"{name} has no insertion deeper than {deepest.depth:.3g} mm: this looks like {unit}",
                expected="mm",
                fix=f"multiply all lengths by {LENGTH_UNITS[unit]:g}",
                where=f"{group[0].where}",
            )
        else:
            yield from faults


def name_small_unit(deepest: Insertion) -> str:
    """Return the unit in which the depth of the deepest insertion was probably written; "" if it is in mm."""
    depths = {unit: LENGTH_UNITS[unit] * deepest.depth for unit in ("inches", "centimetres")}
    likely = (unit for unit, depth in depths.items() if MIN_DEEPEST_MM <= depth < deepest.needle.length)
    return next(likely, "") if deepest.depth < MIN_DEEPEST_MM else ""


def _find_count_fault(entry: ListedInsertion) -> Iterator[Fault]:
    insertion, met = entry.insertion, len(entry.insertion.sequence)
    stated = (
        f"the boundaries of medium {insertion.medium}" if entry.row.boundaries is None else "boundaries_mm"
    )
    allowed = {insertion.layers, insertion.layers_alternative}
    if met in allowed:
        return
    listed = f"{' or '.join(map(str, sorted(allowed)))} {'is' if len(allowed) == 1 else 'are'} listed"
    depths = ", ".join(f"{depth:.2f}" for depth in insertion.boundaries) or "none"
    order = " > ".join(map(str, insertion.sequence))
    fix = f"look at which layers it met, and at {stated}"
    fix += f" ({MISSED_FIX})" if insertion.surfaces and met == 1 else ""
    yield DataError(
        f"{insertion.id} meets {met} layer{'' if met == 1 else 's'} ({order}; "
        f"boundaries at {depths} mm), but {listed}",
        expected="as many in `layers` or `layers_alternative`",
        fix=fix,
        where=entry.where,
    )
