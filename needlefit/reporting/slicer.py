"""Write needles for 3D Slicer as curves (`.mrk.json`), simulated or reconstructed; LPS, mm."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.datasets.columns import POINT_COLUMNS
from needlefit.datasets.formats.markups import CurveStyle, Markups, write_mrk_json
from needlefit.errors import ConfigError
from needlefit.geometry.curves import arc_length
from needlefit.geometry.frames import Placement
from needlefit.geometry.measured_curve import measure_curve
from needlefit.inference.identifiability.directions import NORMAL_95_HALF_WIDTH_SD
from needlefit.mechanics.shape import NeedleShape, compute_positions
from needlefit.project.folders import require_folder
from needlefit.reporting.labels import GREEN, GREY, METHOD_COLOURS, PAPER_COLOUR, SKY_BLUE, rgb
from needlefit.schemas.origin import ORIGIN_MARKS

if TYPE_CHECKING:
    from needlefit.imaging.reconstruction import Reconstruction

LINE_WIDTH_MM, THIN_LINE_WIDTH_MM = 0.6, 0.3  # widths of lines (mm): of needles, and of the edges of bands
# number of points of a simulated needle before its entry into the tissue, and from there on
POINTS_BEFORE_ENTRY, POINTS_INSERTED = 25, 51
_FITTED_COLOUR = METHOD_COLOURS["fitted"]


def write_needles(needles: pd.DataFrame, origin_mark: str, folder: Path) -> None:
    """Write every needle of the table "needles" of a run to `folder`, in the patient coordinates of its scan.

    `<id>.mrk.json` holds curves: measured, fitted (predicted where the fit never saw it), the edges of the
    simultaneous 95 % band and its median. The band of a held-out needle is the predicted one of its
    measurement, that of a fitted needle the one of the parameters.
    """
    folder.mkdir(exist_ok=True)
    summary = f" ({origin_mark})" if origin_mark else ""
    for insertion, rows in needles.groupby("insertion", sort=False):
        write_mrk_json(folder / f"{insertion}.mrk.json", _needle_curves(str(insertion), rows, summary))


def write_simulated_needle(placement: Placement, shapes: Sequence[NeedleShape], path: Path) -> bool:
    """Write a simulated needle, base to tip, in patient coordinates: a curve for every step that was solved.

    Return whether there was any to write.

    ConfigError if the ending of `path` is not .mrk.json or its folder does not exist.
    """
    if not path.name.lower().endswith(".mrk.json"):
        raise ConfigError(
            f"cannot write a `{path.suffix}` file for 3D Slicer",
            where=path,
            expected="a name that ends in .mrk.json",
            fix=f"write to {path.stem or 'needle'}.mrk.json",
        )
    require_folder(path)
    curves = [_place_simulated(placement, shape) for shape in shapes if shape.converged]
    if not curves:
        return False
    steps = [f"needle, step {n}" for n in range(1, len(curves) + 1)] if len(shapes) > 1 else ["needle"]
    lists = [
        Markups(path, f"{name}, {shape.depth:g} mm deep", "Curve", _arc_labels(s), points)
        for name, shape, (points, s) in zip(steps, shapes, curves, strict=False)
    ]
    write_mrk_json(path, [(markups, CurveStyle(rgb(_FITTED_COLOUR), LINE_WIDTH_MM)) for markups in lists])
    return True


def _needle_curves(insertion: str, rows: pd.DataFrame, summary: str) -> Iterator[tuple[Markups, CurveStyle]]:
    first = rows.iloc[0]
    origin = "predicted" if first["role"] == "validate" else "fitted"
    source = "predicted" if first["band_source"] == "predicted" else "parameters"
    looks = {
        "measured": ("measured", PAPER_COLOUR, LINE_WIDTH_MM),
        "fitted": (origin, _FITTED_COLOUR, float(first["diameter_mm"])),
        "middle": (f"median, {source}", SKY_BLUE, LINE_WIDTH_MM),
        "low": (f"simultaneous 95 % band, low, {source}", SKY_BLUE, THIN_LINE_WIDTH_MM),
        "high": (f"simultaneous 95 % band, high, {source}", SKY_BLUE, THIN_LINE_WIDTH_MM),
    }
    curves, places = rows["curve"].to_numpy(), rows[list(POINT_COLUMNS)].to_numpy(dtype=np.float64)
    for curve, (name, colour, thickness) in looks.items():
        points = places[curves == curve]
        if len(points):
            labels = _arc_labels(measure_curve(points).s if curve == "measured" else arc_length(points))
            markups = Markups(Path(insertion), f"{insertion} {name}{summary}", "Curve", labels, points)
            yield markups, CurveStyle(rgb(colour), thickness)


def _place_simulated(placement: Placement, shape: NeedleShape) -> tuple[Floats, Floats]:
    """Return points (K, 3) from base to tip, LPS, and their distances from the entry (K,), mm."""
    before = np.linspace(shape.x[0], 0.0, POINTS_BEFORE_ENTRY) if shape.x[0] < 0 else np.zeros(1)
    inserted = np.linspace(0.0, shape.depth, POINTS_INSERTED)[1:] if shape.depth > 0 else np.empty(0)
    s = np.concatenate([before, inserted])
    return placement.to_patient(compute_positions(shape, s)), s


def _arc_labels(s: Floats, begins: str = "entry") -> tuple[str, ...]:
    """Return what stands at each point: its distance from the entry; the ends say which they are.

    `begins`: what the first point is where none lies at the entry.
    """
    nearest = int(np.argmin(np.abs(s)))
    first = {nearest: "entry"} if begins == "entry" or abs(s[nearest]) < 1e-6 else {0: begins}
    named = {**first, len(s) - 1: "tip"}
    return tuple(named.get(n, f"{distance:.1f} mm") for n, distance in enumerate(s))


POINT_SIZE_MM = 1.5  # size of points in 3D Slicer (mm)


def write_scan(reconstruction: "Reconstruction", folder: Path) -> None:
    """Write the objects that Slicer shows over the scan to `folder`.

    `<id>.mrk.json` holds the whole needle, the part from entry to tip, the edges of its pointwise 95 % band
    toward and away from the bending side, entry, faces of a guide and tip, where layers are crossed, and the
    markers found.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_mrk_json(folder / f"{reconstruction.scan.id}.mrk.json", _scan_markups(reconstruction))


def _scan_markups(reconstruction: "Reconstruction") -> Iterator[tuple[Markups, CurveStyle]]:
    """Yield the curves and points of a reconstruction, LPS, and how each is drawn."""
    origin_mark = ORIGIN_MARKS[reconstruction.scan.origin]
    summary = f" ({origin_mark})" if origin_mark else ""
    whole = reconstruction.needle_axis.points
    inserted = reconstruction.patient.to_local(reconstruction.points)
    depth = reconstruction.depth
    # along y of the constraint frame, as it lies in the scan
    across = reconstruction.patient.rotation.T @ reconstruction.frame.rotation[:, 1]
    half = NORMAL_95_HALF_WIDTH_SD * reconstruction.sd[:, None] * across
    along = arc_length(whole)
    curves = [
        ("whole needle", whole, along + depth - along[-1], GREY, THIN_LINE_WIDTH_MM),
        ("inserted", inserted, arc_length(inserted), _FITTED_COLOUR, LINE_WIDTH_MM),
    ]
    for end, points in (("low", inserted - half), ("high", inserted + half)):
        name = f"pointwise 95 % band, {end}"
        curves.append((name, points, arc_length(inserted), SKY_BLUE, THIN_LINE_WIDTH_MM))
    scan = reconstruction.scan.id
    for name, points, s, colour, thickness in curves:
        markups = Markups(Path(scan), f"{scan} {name}{summary}", "Curve", _arc_labels(s, "base"), points)
        yield markups, CurveStyle(rgb(colour), thickness)
    for name, labels, points, colour in _scan_points(reconstruction):
        if len(points):
            markups = Markups(Path(scan), f"{scan} {name}{summary}", "Fiducial", labels, points)
            yield markups, CurveStyle(rgb(colour), POINT_SIZE_MM)


def _scan_points(reconstruction: "Reconstruction") -> Iterator[tuple[str, tuple[str, ...], Floats, str]]:
    """Yield name, labels, places (K, 3) and colour of each list of points."""
    layers, ends = reconstruction.layers, reconstruction.patient.to_local(reconstruction.points[[0, -1]])
    yield "entry and tip", ("entry", "tip"), ends, PAPER_COLOUR
    yield "faces of the guide", ("guide begins", "guide ends"), reconstruction.guide_faces, GREY
    into = tuple(
        f"into layer {layer}, {depth:.1f} mm"
        for layer, depth in zip(layers.sequence[1:], layers.boundaries, strict=True)
    )
    yield "layer crossings", into, reconstruction.patient.to_local(layers.points), SKY_BLUE
    if (markers := reconstruction.markers) is not None:
        fit = reconstruction.registration
        paired = {} if fit is None else {int(detected): int(stated) for detected, stated in fit.pairs}
        # the number of its known marker, counted from 0, or none
        names = tuple(
            f"marker {paired[n]}" if n in paired else f"found {n}, no known marker"
            for n in range(len(markers.centers))
        )
        yield "markers", names, markers.centers, GREEN
