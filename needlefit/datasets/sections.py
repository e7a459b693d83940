"""Read and write the cross-sections through which a reconstruction drew a needle: `sections/<id>.toml`."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.faults import Fault
from needlefit.datasets.insertion import Dataset, select_compared_places
from needlefit.datasets.layers import LENGTH_TOLERANCE_MM, ListedInsertion
from needlefit.datasets.observations import HELD
from needlefit.errors import DataError
from needlefit.geometry.smoothing_spline import (
    DEGREE,
    SplineSections,
    compute_tip,
    find_empty_pieces,
    make_knots,
)
from needlefit.project.toml import dumps, load, locate_key
from needlefit.schemas.dataset import DatasetRecord, SectionsRecord

SECTIONS_PATTERN = "sections/{id}.toml"  # place of the cross-sections of an insertion in the dataset's folder

# largest distance of the tip of the spline through the sections from that of the centreline, in SDs
MAX_TIP_SDS = 5.0
MAX_TIP_MM = 0.05  # distance (mm) that is allowed besides, for points stored with few digits
# largest SD of a Gaussian, as a fraction of the compared length: four SDs then reach over the whole needle
MAX_WIDTH_FRACTION = 0.25
LENGTH_DIGITS = 5  # number of decimals of lengths in mm
WEIGHT_DIGITS = 6  # number of decimals of weights and deviations


def find_sections(
    row: InsertionRow, centerline: Floats, folder: Path, record: DatasetRecord
) -> SplineSections | None:
    """Return an insertion's cross-sections (world), None where the dataset has none.

    The spline through them must end where the `centerline` (N, 3), world, ends, else DataError; ConfigError
    of a file that is no record of sections.
    """
    if record.measurement is None or record.measurement.sections is None:
        return None
    path = folder / record.measurement.sections.replace("{id}", row.id)
    sections = from_record(load(path, SectionsRecord))
    if abs(sections.s[-1] - row.depth) > LENGTH_TOLERANCE_MM:
        raise DataError(
            f"the tip lies at {sections.s[-1]:.2f} in s_mm, but depth_mm is {row.depth:.2f}",
            expected="arc lengths from first contact, mm, the tip last",
            fix="count s_mm from the entry, or correct depth_mm",
            where=path,
        )
    if len(find_empty_pieces(sections.q, sections.weights, sections.knots)):
        raise DataError(
            "the sections do not determine the spline",
            expected="a section of positive weight between all knots",
            fix="leave out knots without sections",
            where=locate_key(path, "weights"),
        )
    try:
        tip, sd = compute_tip(sections)
    except np.linalg.LinAlgError:
        raise DataError(
            "weights of sections differ too much to draw a spline",
            expected="weights of about 1, or less",
            fix="correct weights",
            where=path,
        ) from None
    off, most = float(np.linalg.norm(tip - centerline[-1])), MAX_TIP_SDS * sd + MAX_TIP_MM
    if not off <= most:
        raise DataError(
            f"the spline through the sections ends {off:.3g} mm from the centreline's end",
            expected=f"at most {most:.2g} mm",
            fix="correct points_mm, or store the centreline that was drawn through them",
            where=path,
        )
    return sections


def find_operator_faults(
    record: DatasetRecord, listed: Sequence[ListedInsertion], file: Path
) -> Iterator[Fault]:
    """Yield a fault if the points of insertions do not suit the knots, or the width of a Gaussian."""
    stated = record.measurement
    if stated is None or (stated.knot_spacing_mm is None and stated.width_mm is None):
        return
    pose, drop = record.frame.pose, record.frame.drop_proximal_mm
    insertions = [entry.insertion for entry in listed]
    compared = {insertion.id: select_compared_places(pose, drop, insertion)[1] for insertion in insertions}
    spacing = stated.knot_spacing_mm
    for name, s in () if spacing is None else compared.items():
        knots = make_knots(s[0], s[-1], spacing or 0.0)
        if len(s) < len(knots) - DEGREE - 1 or len(find_empty_pieces(s, np.ones(len(s)), knots)):
            key = "measurement.knot_spacing_mm"
            yield DataError(
                f"{key} is {spacing:g}: the points of {name} are too sparse for it",
                expected="a point between all neighbouring knots",
                fix="enlarge it, or store the points more densely",
                where=locate_key(file, key),
            )
            return
    length, name = min((float(np.ptp(s)), name) for name, s in compared.items())
    most, key = math.floor(100 * MAX_WIDTH_FRACTION * length) / 100, "measurement.width_mm"
    if stated.width_mm is not None and stated.width_mm > most:
        yield DataError(
            f"{key} is {stated.width_mm:g}: too wide for the {length:.3g} mm compared of {name}",
            expected=f"at most a quarter of that, {most:g}",
            fix="correct it, or leave out insertions that are too short",
            where=locate_key(file, key),
        )


def from_record(record: SectionsRecord) -> SplineSections:
    """Return the cross-sections that a file holds."""
    return SplineSections(
        q=np.array(record.q_mm),
        s=np.array(record.s_mm),
        points=np.array(record.points_mm),
        weights=np.array(record.weights),
        knots=np.array(record.knots_mm),
        sigma=record.sigma_mm,
        shared_sd=record.shared_sd_mm,
        shared_along=np.array(record.shared_along_mm or (0.0, 0.0, 0.0)),
    )


def describe_measurement(dataset: Dataset) -> str:
    """Return what was measured of the needles of a dataset, and what that does to shapes, for people."""
    kinds = dict.fromkeys(name for one in dataset.insertions for name in one.observations)
    words = (HELD[kind].words if kind in HELD else _describe_points(dataset) for kind in kinds)
    return "; ".join(dict.fromkeys(words))


def _describe_points(dataset: Dataset) -> str:
    stated = dataset.measurement
    if stated.operator == "gaussian":
        return f"points smoothed along the needle by a Gaussian of SD {stated.width_mm:g} mm"
    if stated.operator == "unknown":
        size = f"SD {stated.bias_sd_mm:g} mm over {stated.bias_length_mm:g} mm"
        return f"points with an unknown smooth bias, {size}"
    if stated.operator == "spline" and stated.sections is None:
        return f"points on a smoothing spline, a knot every {stated.knot_spacing_mm:g} mm"
    sections = [insertion.sections for insertion in dataset.insertions if insertion.sections is not None]
    if not sections:
        return "points of the needle itself, with stated errors"
    counts = [len(section.q) for section in sections]
    sigma = float(np.sqrt(np.mean([section.sigma**2 for section in sections])))
    return (
        f"smoothing splines through {min(counts)} to {max(counts)} stored cross-sections each, "
        f"SD {sigma:.3f} mm per direction"
    )


def format_sections(sections: SplineSections) -> str:
    """Return the text of a file of cross-sections."""
    record = SectionsRecord(
        schema_=SectionsRecord.SCHEMA,
        q_mm=_round(sections.q),
        s_mm=_round(sections.s),
        points_mm=tuple(map(_round, sections.points)),
        weights=_round(sections.weights, WEIGHT_DIGITS),
        knots_mm=_round(sections.knots),
        sigma_mm=round(sections.sigma, WEIGHT_DIGITS),
        shared_sd_mm=round(sections.shared_sd, WEIGHT_DIGITS),
        shared_along_mm=_round(sections.shared_along) if sections.shared_along.any() else None,
    )
    return dumps(record.model_dump(mode="json", by_alias=True, exclude_none=True))


def _round(values: np.ndarray, digits: int = LENGTH_DIGITS) -> tuple[float, ...]:
    return tuple(round(float(value), digits) + 0.0 for value in values)
