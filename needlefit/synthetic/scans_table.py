"""`scans.csv` of the twin: one row a scan, and beside it what it takes to reconstruct it."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.schema import BEVEL, DIRECTION, ENTRY
from needlefit.imaging.scan import LayerSource, Scan, Stage

COLUMNS = (
    *("id", "scan", "medium", "specimen", "markers", "surfaces", "surfaces_in"),
    *(*ENTRY, *DIRECTION, "pose_shift_sd_mm", "pose_angle_sd_deg", *BEVEL, "bevel_side"),
    *("layers", "layers_alternative", "origin"),
)
"""The columns of `scans.csv` that the twin fills."""


def scans_text(scans: Sequence[Scan], folder: Path) -> str:
    """Return the table of `scans`; their files are named relative to `folder`, in which they lie."""
    rows = [COLUMNS, *(_cells(scan, folder) for scan in scans)]
    return "".join(",".join(row) + "\n" for row in rows)


def markers_text(places: NDArray[np.float64]) -> str:
    """Return the table of the markers' stated places (M, 3), world, mm."""
    rows = [f"ball{n},{x:.4f},{y:.4f},{z:.4f}" for n, (x, y, z) in enumerate(places, start=1)]
    return "\n".join(["name,x_mm,y_mm,z_mm", *rows]) + "\n"


def _cells(scan: Scan, folder: Path) -> tuple[str, ...]:
    surfaces = ";".join(_surface(source, folder) for source in scan.surfaces)
    return (
        *(scan.id, _inside(scan.volume, folder), scan.medium, scan.specimen),
        *(_inside(scan.markers, folder), surfaces, scan.surfaces_in if surfaces else ""),
        *_stage(scan.stage),
        *_numbers(scan.bevel, 6),
        f"{scan.side:+d}",
        *("" if count is None else str(count) for count in (scan.layers, scan.layers_alternative)),
        scan.origin,
    )


def _surface(source: LayerSource, folder: Path) -> str:
    return f"{_inside(source.path, folder)}={source.kind}:{source.into}"


def _stage(stage: Stage | None) -> tuple[str, ...]:
    if stage is None:
        return ("",) * 8
    deviations = np.array([stage.shift_sd, math.degrees(stage.angle_sd)])
    return (*_numbers(stage.entry, 4), *_numbers(stage.direction, 6), *_numbers(deviations, 4))


def _inside(path: Path | None, folder: Path) -> str:
    return "" if path is None else path.relative_to(folder).as_posix()


def _numbers(values: NDArray[np.float64] | None, digits: int) -> tuple[str, ...]:
    """Return the cells of `values`, three empty ones for none; never "-0.0000"."""
    if values is None:
        return ("", "", "")
    return tuple(f"{round(float(value), digits) + 0.0:.{digits}f}" for value in values)
