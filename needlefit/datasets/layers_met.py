"""Whether the surfaces of a medium can be its layers, and whether insertions meet the layers listed."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needlefit.datasets.faults import Fault
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.layers import layers_before
from needlefit.geometry.crossings import crossings
from needlefit.geometry.frames import Frame
from needlefit.geometry.surfaces import Surface, moved
from needlefit.project.toml_lines import locate_key
from needlefit.project.unit_warnings import BOUNDARY_TO_DEPTH, LENGTH_UNITS
from needlefit.schemas.dataset import DatasetRecord

HALF_TURN = Frame(np.zeros(3), np.diag([-1.0, -1.0, 1.0]))
"""From RAS to LPS, and back: x and y change their signs."""


@dataclass(frozen=True)
class Placed:
    """An insertion, and the line of the table on which it stands."""

    insertion: Insertion
    where: str


def media_faults(record: DatasetRecord, file: Path) -> Iterator[Fault]:
    """Say which media skip a layer number: an `into` mistyped, or a surface left out."""
    for name, medium in record.media.items():
        numbers = {surface.into for surface in medium.surfaces}
        skipped = sorted(set(range(2, max(numbers, default=1))) - numbers)
        if skipped:
            listed = ", ".join(map(str, sorted(numbers)))
            yield Fault(
                locate_key(file, f"media.{name}.surfaces"),
                f"no surface of medium {name} leads into layer {skipped[0]}; they lead into {listed}",
                "layers numbered without a gap: 1, where needles begin, then 2, 3, ...",
                "correct `into`, or add the surface that is missing",
            )


def surface_faults(placed: Sequence[Placed], record: DatasetRecord, file: Path) -> Iterator[Fault]:
    """Say which insertions do not meet the layers listed for them, and why if all miss all surfaces."""
    for name in dict.fromkeys(one.insertion.medium for one in placed):
        group = [one for one in placed if one.insertion.medium == name]
        copies = _copies(group[0].insertion.surfaces)
        if copies:  # their layers cannot be counted
            yield from (_twice(locate_key(file, f"media.{name}.surfaces"), name, *pair) for pair in copies)
            continue
        unit = _boundary_unit(group, record.media[name].boundaries_mm or ())
        if unit:
            yield Fault(
                locate_key(file, f"media.{name}.boundaries_mm"),
                f"boundaries_mm of medium {name} do not give the layers listed for its insertions, and do so "
                f"once they are multiplied by {LENGTH_UNITS[unit]:g}: this looks like {unit}",
                "depths along the needle, mm",
                f"multiply boundaries_mm by {LENGTH_UNITS[unit]:g}",
            )
            continue
        missed = all(one.insertion.surfaces and one.insertion.sequence == (1,) for one in group)
        if missed and all(_meets_turned(one.insertion) for one in group):
            yield Fault(
                locate_key(file, f"media.{name}.surfaces"),
                f"all {len(group)} insertions into {name} miss all its surfaces, and meet them once x and y "
                "change their signs: surfaces and centrelines are one in LPS and one in RAS",
                "surfaces and centrelines in one frame",
                "export the surfaces again in the frame of the centrelines (3D Slicer asks: LPS or RAS)",
            )
        else:
            yield from (fault for one in group for fault in _layer_faults(one))


def _boundary_unit(group: Sequence[Placed], boundaries: Sequence[float]) -> str:
    """Return the unit of given depths with which alone all insertions meet the layers listed, or ""."""
    if not boundaries or _meet_listed(group, boundaries, 1.0):
        return ""
    deepest = max(one.insertion.depth for one in group)
    likely = (
        unit
        for unit, mm in LENGTH_UNITS.items()
        if mm * boundaries[0] > BOUNDARY_TO_DEPTH * deepest and mm * boundaries[-1] < deepest
    )
    return next((unit for unit in likely if _meet_listed(group, boundaries, LENGTH_UNITS[unit])), "")


def _meet_listed(group: Sequence[Placed], boundaries: Sequence[float], factor: float) -> bool:
    scaled = factor * np.array(boundaries)
    return all(
        len(layers_before(scaled, _reach(one.insertion))[1])
        in (one.insertion.layers, one.insertion.layers_alternative)
        for one in group
    )


def _reach(insertion: Insertion) -> float:
    """Return the depth along C's x down to which given boundaries are met, mm."""
    return insertion.depth if insertion.pose_source == "none" else float(insertion.planar[-1, 0])


def _twice(where: str, medium: str, one: str, other: str) -> Fault:
    listed = f"lists surface {one} twice" if one == other else f"lists one surface as {one} and as {other}"
    expected = "a surface of its own for every boundary"
    return Fault(where, f"medium {medium} {listed}", expected, "name the right file, or remove one")


def _copies(surfaces: Sequence[Surface]) -> list[tuple[str, str]]:
    """Return the names of the surfaces of one insertion that are the same, two by two."""
    seen: dict[bytes, str] = {}
    found = []
    for surface in surfaces:
        key = np.ascontiguousarray(surface.mesh.vertices).tobytes()
        found += [(seen[key], surface.name)] if key in seen else []
        seen.setdefault(key, surface.name)
    return found


def _meets_turned(insertion: Insertion) -> bool:
    turned = [moved(surface, HALF_TURN) for surface in insertion.surfaces]
    return len(crossings(insertion.centerline, turned).sequence) > 1


def _layer_faults(one: Placed) -> Iterator[Fault]:
    insertion, met = one.insertion, len(one.insertion.sequence)
    allowed = {insertion.layers, insertion.layers_alternative}
    if met in allowed:
        return
    listed = " or ".join(map(str, sorted(allowed)))
    depths = ", ".join(f"{depth:.2f}" for depth in insertion.boundaries) or "none"
    order = " > ".join(map(str, insertion.sequence))
    yield Fault(
        one.where,
        f"{insertion.id} meets {met} layers ({order}; interfaces at {depths} mm), but {listed} are listed",
        f"{listed} layers",
        f"correct layers or layers_alternative, or the boundaries of medium {insertion.medium}",
    )
