"""The media of a dataset, and which of their layers an insertion meets."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from needlefit.datasets.faults import Fault, from_error
from needlefit.datasets.insertion import Medium
from needlefit.datasets.schema import Floats
from needlefit.errors import DataError
from needlefit.geometry.crossings import crossings
from needlefit.geometry.frames import Frame
from needlefit.geometry.surfaces import Surface, read_surface, surface_faults
from needlefit.project.records.dataset import DatasetRecord, SurfaceRecord

SMALLEST_SURFACE = 1.0
"""A surface whose greatest extent is less than this, mm, was written in metres."""


RESTORE = "check its name against dataset.toml, or restore it"
EXPORT = "export the surface again as triangles, e.g. as STL"


def read_media(record: DatasetRecord, folder: Path, found: list[Fault]) -> dict[str, Medium]:
    """Return every medium whose surfaces have no fault; note the faults of the others."""
    media = {}
    for name, medium in record.media.items():
        surfaces = [_read(surface, folder, found) for surface in medium.surfaces]
        depths = medium.boundaries_mm
        if all(surface is not None for surface in surfaces):
            boundaries = None if depths is None else np.array(depths, dtype=np.float64)
            media[name] = Medium(name, tuple(s for s in surfaces if s is not None), boundaries)
    return media


def _read(record: SurfaceRecord, folder: Path, found: list[Fault]) -> Surface | None:
    path = folder / record.file
    try:
        surface = read_surface(path, record.kind, record.into)
    except DataError as error:
        fault = from_error(error)
        fault = fault if fault.mend else replace(fault, mend=RESTORE if not path.is_file() else EXPORT)
        if fault not in found:  # two media may share a surface
            found.append(fault)
        return None
    faults = list(_surface_faults(surface, path))
    found += [fault for fault in faults if fault not in found]
    return None if faults else surface


def _surface_faults(surface: Surface, path: Path) -> Iterator[Fault]:
    expected = {
        "solid": "a closed surface in one piece, its triangles turned outward",
        "sheet": "one piece with one rim, larger than the tissue it parts",
    }[surface.kind]
    for what in surface_faults(surface.mesh, surface.kind):
        yield Fault(str(path), f"the {surface.kind} {what}", expected, "mend the mesh (e.g. MeshLab, Slicer)")
    extent = float(np.ptp(surface.mesh.vertices, axis=0).max())
    if extent < SMALLEST_SURFACE:
        yield Fault(
            str(path),
            f"is {extent:.3g} across: this looks like metres",
            "millimetres",
            "multiply its coordinates by 1000",
        )


def numbering_faults(record: DatasetRecord, file: Path) -> Iterator[Fault]:
    """Say which media skip a layer number: an `into` mistyped, or a surface left out."""
    for name, medium in record.media.items():
        numbers = {surface.into for surface in medium.surfaces}
        skipped = sorted(set(range(2, max(numbers, default=1))) - numbers)
        if skipped:
            listed = ", ".join(map(str, sorted(numbers)))
            yield Fault(
                str(file),
                f"no surface of medium {name} leads into layer {skipped[0]}; they lead into {listed}",
                "layers numbered without a gap: 1, where needles begin, then 2, 3, ...",
                "correct `into`, or add the surface that is missing",
            )


def layers_met(
    centerline: Floats, frame: Frame, medium: Medium, reach: float
) -> tuple[Floats, tuple[int, ...]]:
    """Return the interfaces that an insertion crosses, as depths (n - 1,) along C's x, and the n layers met.

    With surfaces they are where the centreline (N, 3) crosses them; with given depths, those before `reach`.
    """
    if medium.boundaries is not None:
        depths = medium.boundaries[medium.boundaries < reach]
        return depths, tuple(range(1, len(depths) + 2))
    met = crossings(centerline, medium.surfaces)
    x = frame.to_local(met.points)[:, 0]
    # the centreline's first point is not exactly the entry: an interface there may project before it
    ordered: Floats = np.maximum.accumulate(np.maximum(x, 0.0))
    return ordered, met.sequence
