"""Make candidate insertions with the layers that each would meet."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.layers import select_layers
from needlefit.errors import ConfigError
from needlefit.geometry.frames import Frame, make_entry_frame, normalize
from needlefit.inference.forward_model import make_batch, predict
from needlefit.inference.planned_layers import with_planned_layers
from needlefit.mechanics.batch import compute_batch_positions, simulate_batches
from needlefit.mechanics.shape import sample_inserted_points
from needlefit.project.toml_lines import describe_key
from needlefit.studies.further_insertion import WeightedPosterior
from needlefit.studies.job import Job
from needlefit.studies.kinds.next_insertion.schema import CandidateEntryRecord, NextInsertionRecord

CandidatePlace = tuple[CandidateEntryRecord, float, float]
"""Entry, angle (degrees) and depth (mm)."""

MEASURED_POINTS = 31
"""At which a candidate would be measured: neighbours err alike, so that more add next to nothing."""


def iterate_places(record: NextInsertionRecord) -> Iterator[CandidatePlace]:
    """Yield the entry, angle and depth of every candidate."""
    for entry in record.entries:
        for angle in entry.angles_deg:
            for depth in entry.depths_mm or record.depths_mm:
                yield entry, angle, depth


def predict_candidate(
    job: Job, like: Insertion, place: CandidatePlace, values: Mapping[str, float]
) -> Insertion | None:
    """Return a candidate as `values` (Pa, mm) predict it; None if it has no solution or leaves the medium.

    The layers are those that the predicted needle meets, the same for all draws of the parameters: as it will
    be once they are measured.

    Raises
    ------
    ConfigError
        If nothing says which layers it meets.
    """
    entry, angle, depth = place
    planned = replace(like, id=entry.name, depth=depth, frame=frame_of(entry, angle))
    if entry.layers is not None:
        boundaries, met = select_layers(np.array(entry.boundaries_mm, dtype=np.float64), depth)
        sequence = entry.layers[: len(met)]
        through = replace(planned, boundaries=boundaries, sequence=sequence)
        return None if max(sequence) > job.medium.layers else with_predicted_shape(job, through, values)
    if not planned.surfaces:
        raise ConfigError(
            f"medium {planned.medium} has no surfaces: the layers at entry `{entry.name}` are not known",
            where=describe_key(job.name, "entries"),
            key="entries",
            fix="list the entry's `layers`, and their boundaries_mm",
        )
    met_layers = with_planned_layers(planned, values, job.medium, job.dataset.needle)
    return None if met_layers is None else with_predicted_shape(job, met_layers, values)


def with_predicted_shape(job: Job, insertion: Insertion, values: Mapping[str, float]) -> Insertion | None:
    """Return an insertion with the shape that `values` predict as the measured one; None if there is none."""
    needle = predict(values, job.medium, job.dataset.needle, insertion)
    return (
        replace(insertion, planar=sample_inserted_points(needle, MEASURED_POINTS), sections=None)
        if needle.converged
        else None
    )


def frame_of(entry: CandidateEntryRecord, angle: float) -> Frame:
    """Return the frame C in the world at an entry, with x turned by `angle` (degrees) to the bevel side."""
    x = normalize(entry.direction)
    y = make_entry_frame(entry.position_mm, x, entry.bending_direction).rotation[:, 1]
    cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    return make_entry_frame(entry.position_mm, cos * x + sin * y, cos * y - sin * x)


def predict_tips(known: WeightedPosterior, insertion: Insertion) -> Floats:
    """Return the tip deflection (B,) of an insertion for every draw, mm; NaN where a solve fails."""
    batch = make_batch(known.sets, known.problem.medium, known.problem.dataset.needle, insertion)
    (shapes,) = simulate_batches([batch], 1)
    found: Floats = compute_batch_positions(shapes, np.array([insertion.depth]))[:, 0, 1]
    return np.where(shapes.converged, found, np.nan)
