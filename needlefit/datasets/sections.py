"""Read and write the cross-sections through which a reconstruction drew a needle: `sections/<id>.toml`."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.faults import Fault, from_error
from needlefit.datasets.insertion import Dataset, select_compared_places
from needlefit.datasets.layers import ListedInsertion
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.curves import arc_length
from needlefit.geometry.smoothing_spline import (
    SplineSections,
    draw_spline,
    find_empty_pieces,
    find_least_spacing,
)
from needlefit.project.toml import dumps, load, locate_key
from needlefit.schemas.dataset import DatasetRecord, SectionsRecord

SECTIONS_PATTERN = "sections/{id}.toml"

MAX_LENGTH_DIFFERENCE_MM = 2.0  # the arc length of the tip may differ by this, mm, from the inserted depth
# How far the spline through the cross-sections may be off the centreline: this many of its standard
# deviations, plus this, mm. Those of the synthetic dataset are 0.001 mm apart at most; a spline sampled
# coarsely or stored with few digits stays below the second.
MAX_DISTANCE_SDS, MAX_DISTANCE_MM = 5.0, 0.05
# Largest SD of a Gaussian, as part of the length compared: four SDs then reach over the whole needle.
MAX_WIDTH_FRACTION = 0.25
LENGTH_DIGITS, WEIGHT_DIGITS = 5, 6


def locate_sections(id_: str, folder: Path, record: DatasetRecord) -> Path:
    """Return the file of an insertion's cross-sections; the dataset must state one."""
    assert record.measurement is not None and record.measurement.sections is not None
    return folder / record.measurement.sections.replace("{id}", id_)


def find_sections(
    row: InsertionRow, folder: Path, record: DatasetRecord
) -> tuple[SplineSections | None, list[Fault]]:
    """Return an insertion's cross-sections (world), None where the dataset has none, and their faults."""
    if record.measurement is None or record.measurement.sections is None:
        return None, []
    path = locate_sections(row.id, folder, record)
    try:
        sections = from_record(load(path, SectionsRecord))
    except (ConfigError, DataError) as error:
        return None, [from_error(error)]
    if abs(sections.s[-1] - row.depth) > MAX_LENGTH_DIFFERENCE_MM:
        what = f"the tip lies at {sections.s[-1]:.2f} in s_mm, but depth_mm is {row.depth:.2f}"
        expected = "arc lengths from first contact, mm, the tip last"
        return None, [Fault(str(path), what, expected, "count s_mm from the entry, or correct depth_mm")]
    empty = find_empty_pieces(sections.q, sections.weights, sections.knots)
    if len(empty):
        more = f" (nor in {len(empty) - 1} more intervals)" if len(empty) > 1 else ""
        what = f"no section between the knots {empty[0, 0]:g} and {empty[0, 1]:g} has a weight above 0{more}"
        expected = "a section of positive weight in every interval of knots_mm that q_mm reaches"
        fix = "leave out the sections before the first or behind the last that counts, with their knots"
        return None, [Fault(locate_key(path, "weights"), what, expected, fix)]
    return sections, []


def find_centerline_faults(sections: SplineSections, centerline: Floats, place: str) -> Iterator[Fault]:
    """Yield a fault if the spline through the cross-sections is not the centreline (N, 3), both world.

    They are compared across the needle, at equal arc lengths from the tip, and the tips in every direction.
    """
    along = arc_length(centerline)
    s = along + (sections.s[-1] - along[-1])
    reached = s >= sections.s[0]
    try:
        drawn = draw_spline(sections, np.interp(s[reached], sections.s, sections.q))
    except np.linalg.LinAlgError:
        what = "weights of sections differ so much that no spline can be drawn through them"
        yield Fault(place, what, "weights of about 1, less for sections of doubt", "correct weights")
        return
    off = centerline[reached] - drawn.points
    tangents = drawn.slopes / np.linalg.norm(drawn.slopes, axis=1, keepdims=True)
    off[:-1] -= np.einsum("nd,nd->n", off, tangents)[:-1, None] * tangents[:-1]
    distances, limits = np.linalg.norm(off, axis=1), MAX_DISTANCE_SDS * drawn.sd + MAX_DISTANCE_MM
    worst = int(np.argmax(np.nan_to_num(distances / limits, nan=np.inf)))
    if not distances[worst] <= limits[worst]:
        yield Fault(
            place,
            f"the spline through the sections is {distances[worst]:.3g} mm off the centreline "
            f"{s[reached][worst]:.1f} mm from the entry",
            f"the centreline's own sections, in world coordinates: within {limits[worst]:.2g} mm there",
            "correct points_mm, q_mm, s_mm or knots_mm, or store the centreline that was drawn through them",
        )


def find_operator_faults(
    record: DatasetRecord, listed: Sequence[ListedInsertion], file: Path
) -> Iterator[Fault]:
    """Yield a fault if the points of insertions do not suit the knots, or the width of a Gaussian."""
    stated = record.measurement
    if stated is None:
        return
    compared = {one.insertion.id: _select_arc_lengths(record, one) for one in listed}
    least, sparsest, key = stated.knot_spacing_mm, "", "measurement.knot_spacing_mm"
    while least is not None:  # what suits one curve need not suit the next
        found = ((find_least_spacing(s, least), name) for name, s in compared.items())
        more = next((pair for pair in found if pair[0] is None or pair[0] > least), None)
        if more is None:
            break
        least, sparsest = more
    if sparsest:
        what = f"{key} is {stated.knot_spacing_mm:g}: the points of {sparsest} are too sparse for it"
        expected = "at least 4 points compared" if least is None else f"at least {least + 0.005:.2f}"
        yield Fault(locate_key(file, key), what, expected, "store the points more densely")
    lengths = {name: float(np.ptp(s)) for name, s in compared.items()}
    shortest = min(lengths, key=lambda name: lengths[name])
    most, key = math.floor(100 * MAX_WIDTH_FRACTION * lengths[shortest]) / 100, "measurement.width_mm"
    if stated.width_mm is not None and stated.width_mm > most:
        length = f"{lengths[shortest]:.3g} mm compared of {shortest}"
        what = f"{key} is {stated.width_mm:g}: too wide for the {length}"
        fix = "write the standard deviation of the Gaussian, or leave out insertions that are too short"
        yield Fault(locate_key(file, key), what, f"at most a quarter of that, {most:g}", fix)


def _select_arc_lengths(record: DatasetRecord, listed: ListedInsertion) -> Floats:
    """Return the arc lengths from the entry (K,), mm, of the points compared."""
    frame = record.frame
    return select_compared_places(frame.pose, frame.drop_proximal_mm, listed.insertion)[1]


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
    """Return what the measurement of a dataset does to shapes, for people."""
    stated = dataset.measurement
    if dataset.pose == "tracker":
        return "tips at depths, as tracked"
    if stated.operator == "gaussian":
        return f"points smoothed along the needle by a Gaussian of SD {stated.width_mm:g} mm"
    if stated.operator == "unknown":
        size = f"SD {stated.bias_sd_mm:g} mm over {stated.bias_length_mm:g} mm"
        return f"points with an unknown smooth bias, {size}"
    if stated.operator == "spline" and stated.sections is None:
        return f"points on a smoothing spline, a knot every {stated.knot_spacing_mm:g} mm"
    sections = [one.sections for one in dataset.insertions if one.sections is not None]
    if not sections:
        return "points of the needle itself, with stated errors"
    counts = [len(one.q) for one in sections]
    sigma = float(np.sqrt(np.mean([one.sigma**2 for one in sections])))
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
