"""Where the needle of a measured insertion lies."""

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.geometry.placement import Placement, carried
from needlefit.inference.comparison import target
from needlefit.mechanics.shape import NeedleShape, positions
from needlefit.project.records.recording import PlacementRecord
from needlefit.validation.placed import STATIONS, on_measured


def placement_of(dataset: Dataset, insertion: Insertion, shape: NeedleShape) -> PlacementRecord | None:
    """Return where the constraint frame of a simulated needle lies: where a run's files for Slicer have it.

    Parameters
    ----------
    shape : NeedleShape
        The needle at the measured depth. Where shapes are known only up to a rigid motion, this one is laid
        on the measured one, and what is steered from then on lies in the frame in which it came to lie.

    Returns
    -------
    PlacementRecord or None
        None where such a needle was not found.
    """
    frame = insertion.frame
    if dataset.pose == "free":
        if not shape.converged:
            return None
        s = target(dataset.pose, dataset.drop_proximal, insertion, STATIONS).s
        points = positions(shape, s)
        frame = carried(frame, points, on_measured(insertion, s, points))
    return Placement(frame, insertion.patient).to_record()
