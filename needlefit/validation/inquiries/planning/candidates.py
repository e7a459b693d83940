"""Insertions not made yet: as a study lists them, with the layers that each would meet."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Insertion
from needlefit.datasets.layers import layers_before
from needlefit.errors import ConfigError
from needlefit.geometry.frames import Frame, entry_frame, unit
from needlefit.inference.predict import predict
from needlefit.mechanics.shape import NeedleShape, inserted_points
from needlefit.project.records.next_insertion import EntryRecord, NextInsertionRecord
from needlefit.validation.inquiries.blamed import place as place_of
from needlefit.validation.job import Job, farthest_guide
from needlefit.validation.planned import planned_layers

Floats = NDArray[np.float64]
Place = tuple[EntryRecord, float, float]
"""Entry, angle (degrees) and depth (mm)."""

POINTS = 31
"""At which a candidate would be measured: neighbours err alike, so that more add next to nothing."""


def places(record: NextInsertionRecord) -> Iterator[Place]:
    """Yield where every candidate would be."""
    for entry in record.entries:
        for angle in entry.angles_deg:
            for depth in entry.depths_mm or record.depths_mm:
                yield entry, angle, depth


def template(job: Job, like: str) -> Insertion:
    """Return the insertion whose errors a new one would have.

    Raises
    ------
    ConfigError
        If there is no such insertion.
    """
    known = {insertion.id: insertion for insertion in job.dataset.insertions}
    if like not in known:
        raise ConfigError(
            f"insertion {like} is not in the dataset",
            where=place_of(job.name, "like"),
            key="like",
            expected=f"one of {', '.join(known)}",
        )
    return replace(known[like], side=1, sd=None)


def check_reach(job: Job, like: Insertion, depths: Mapping[str, float]) -> None:
    """Refuse depths (mm, by the study's key) that the needle cannot be inserted to.

    Raises
    ------
    ConfigError
        Naming the first such key.
    """
    guide = farthest_guide(job.parameters, like)
    longest = job.dataset.needle.length - guide
    through = f", held by a guide {guide:g} mm before the tissue," if guide else ""
    for key, depth in depths.items():
        if depth >= longest:
            raise ConfigError(
                f"a needle of {job.dataset.needle.length:g} mm{through} cannot be inserted {depth:g} mm",
                where=place_of(job.name, key),
                key=key,
                expected=f"depths below {longest:g} mm",
                mend=f"correct `{key}`, or the needle's length in the dataset",
            )


def candidate(job: Job, like: Insertion, place: Place, values: Mapping[str, float]) -> Insertion | None:
    """Return a candidate as `values` (Pa, mm) foretell it; None with no solution, or outside the medium.

    The layers are those that the foretold needle meets, the same for all draws of the parameters: as it will
    be once they are measured.

    Raises
    ------
    ConfigError
        If nothing says which layers it meets.
    """
    entry, angle, depth = place
    planned = replace(like, id=entry.name, depth=depth, frame=frame_of(entry, angle))
    layers = _layers(job, planned, entry, values)
    if layers is None or max(layers[1]) > job.medium.layers:
        return None
    return seen(job, replace(planned, boundaries=layers[0], sequence=layers[1]), values)


def seen(job: Job, insertion: Insertion, values: Mapping[str, float]) -> Insertion | None:
    """Return an insertion whose measured shape is the one that `values` foretell; None without one."""
    needle = predict(values, job.medium, job.dataset.needle, insertion)
    return replace(insertion, planar=inserted_points(needle, POINTS)) if needle.converged else None


def frame_of(entry: EntryRecord, angle: float) -> Frame:
    """Return C in the world at an entry: x turned by `angle` (degrees) to where the bevel faces."""
    x = unit(entry.direction)
    y = entry_frame(entry.place_mm, x, entry.bending).rotation[:, 1]
    cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    return entry_frame(entry.place_mm, cos * x + sin * y, cos * y - sin * x)


def _layers(
    job: Job, planned: Insertion, entry: EntryRecord, values: Mapping[str, float]
) -> tuple[Floats, tuple[int, ...]] | None:
    """Return boundaries (n - 1,) and the n layers met; None where the planned path does not come to rest."""
    if entry.layers is not None:
        before, met = layers_before(np.array(entry.boundaries_mm, dtype=np.float64), planned.depth)
        return before, entry.layers[: len(met)]
    if not planned.surfaces:
        raise ConfigError(
            f"medium {planned.medium} has no surfaces: the layers at entry `{entry.name}` are not known",
            where=place_of(job.name, "entries"),
            key="entries",
            mend="list the entry's `layers`, and their boundaries_mm",
        )

    def shape(boundaries: Floats, sequence: tuple[int, ...]) -> NeedleShape:
        return predict(values, job.medium, job.dataset.needle, planned, boundaries, sequence)

    return planned_layers(planned, shape)
