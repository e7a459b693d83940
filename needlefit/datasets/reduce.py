"""A row and its centreline -> an insertion in its bending plane."""

from needlefit.datasets.formats.points import Points
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.layers import Medium, layers_before, layers_met
from needlefit.datasets.schema import Floats, InsertionRow
from needlefit.geometry.frames import Frame, entry_frame
from needlefit.geometry.plane import bending_plane, free_frame


def reduce(row: InsertionRow, points: Points, medium: Medium, patient: Frame) -> Insertion:
    """Return the insertion of a row without faults; `patient`: where its scan stands in the world.

    C stands at the entry pose; its plane is that of `row.bevel`, or, where that is empty, the one in
    which the centreline leaves the entry line. A row without entry pose gets `free_frame`.

    Raises
    ------
    DataError
        If the bevel direction is parallel to the entry.
    """
    centerline = points.values
    frame = _frame(row, centerline)
    local = frame.to_local(centerline)
    if medium.boundaries is None:
        boundaries, sequence = layers_met(centerline, frame, medium.surfaces)
    else:
        reach = row.depth if row.entry is None else float(local[-1, 0])
        boundaries, sequence = layers_before(medium.boundaries, reach)
    return Insertion(
        id=row.id,
        medium=row.medium,
        specimen=row.specimen,
        layers=row.layers,
        layers_alternative=row.layers if row.layers_alternative is None else row.layers_alternative,
        depth=row.depth,
        side=row.side,
        frame=frame,
        pose_source=row.pose_source,
        pose_shift_sd=row.pose_shift_sd,
        pose_angle_sd=row.pose_angle_sd,
        centerline=centerline,
        planar=local[:, :2],
        out_of_plane=local[:, 2],
        boundaries=boundaries,
        sequence=sequence,
        boundary_sd=row.boundary_sd,
        depth_sd=row.depth_sd,
        guide_distance=row.guide_distance,
        sd=points.sd,
        surfaces=medium.surfaces,
        patient=patient,
        base_moved=row.base_moved,
    )


def _frame(row: InsertionRow, centerline: Floats) -> Frame:
    if row.entry is None or row.direction is None:
        frame = free_frame(centerline)
        # a shape bends toward its bevel
        return frame if row.side > 0 else Frame(frame.origin, frame.rotation * [1.0, -1.0, -1.0])
    toward = bending_plane(centerline, row.direction) if row.bevel is None else row.bevel
    return entry_frame(row.entry, row.direction, toward)
