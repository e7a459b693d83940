"""A reconstructed needle for 3D Slicer, on the scan that it was found in: LPS, mm."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.formats.markups import Markups
from needlefit.datasets.formats.mrk_json import CurveStyle, write_mrk_json
from needlefit.geometry.curves import arc_length
from needlefit.geometry.meshes import make_tube, write_ply
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.reporting.names import GREY, METHOD_COLOURS, PAPER, rgb
from needlefit.reporting.slicer import THICK, THIN

Floats = NDArray[np.float64]

POINT = 1.5
"""Points, mm."""

_WHOLE, _INSERTED = GREY, METHOD_COLOURS["fitted"]
_BAND, _MARKER = METHOD_COLOURS["linear_curvature"], METHOD_COLOURS["constant_curvature"]
_NINETY_FIVE = 1.96


def write_scan(reconstruction: Reconstruction, folder: Path, diameter: float) -> tuple[Path, ...]:
    """Write what Slicer shows over the scan to `folder`; return the files.

    `<id>.mrk.json` holds the whole needle, the part from entry to tip, the edges of its 95 % band toward and
    away from the bending side, entry and tip, where layers are crossed, and the markers found.
    `<id>.needle.ply` is the needle's body, of `diameter` (mm), `<id>.band.ply` the space that its inserted
    part takes when it goes through the band.
    """
    folder.mkdir(parents=True, exist_ok=True)
    name = reconstruction.scan.id
    said = " (synthetic)" if reconstruction.scan.origin == "synthetic" else ""
    curves = folder / f"{name}.mrk.json"
    write_mrk_json(curves, _lists(reconstruction, said))
    files = [curves]
    for body, points, radius in _bodies(reconstruction, diameter):
        files.append(folder / f"{name}.{body}.ply")
        toward = _toward(reconstruction)
        write_ply(make_tube(points, radius, toward), files[-1], (f"needlefit: {name}, {body}{said}, mm",))
    return tuple(files)


def _lists(reconstruction: Reconstruction, said: str) -> Iterator[tuple[Markups, CurveStyle]]:
    whole, inserted = reconstruction.needle_axis.points, _inserted(reconstruction)
    depth = reconstruction.depth
    half = _NINETY_FIVE * reconstruction.sd[:, None] * _toward(reconstruction)
    along = arc_length(whole)
    curves = [
        ("whole needle", whole, along + depth - along[-1], _WHOLE, THIN),
        ("inserted", inserted, arc_length(inserted), _INSERTED, THICK),
        ("95 % band, low", inserted - half, arc_length(inserted), _BAND, THIN),
        ("95 % band, high", inserted + half, arc_length(inserted), _BAND, THIN),
    ]
    for name, points, s, colour, thickness in curves:
        yield (
            _list(reconstruction, f"{name}{said}", "Curve", _labels(s), points),
            CurveStyle(rgb(colour), thickness),
        )
    for name, labels, points, colour in _points(reconstruction):
        if len(points):
            yield (
                _list(reconstruction, f"{name}{said}", "Fiducial", labels, points),
                CurveStyle(rgb(colour), POINT),
            )


def _list(
    reconstruction: Reconstruction, name: str, kind: str, labels: tuple[str, ...], points: Floats
) -> Markups:
    scan = reconstruction.scan.id
    return Markups(Path(scan), f"{scan} {name}", kind, labels, points)


def _points(reconstruction: Reconstruction) -> Iterator[tuple[str, tuple[str, ...], Floats, str]]:
    """Yield name, labels, places (K, 3) and colour of each list of points."""
    inserted, layers = _inserted(reconstruction), reconstruction.layers
    yield "entry and tip", ("entry", "tip"), inserted[[0, -1]], PAPER
    into = tuple(
        f"into layer {layer}, {depth:.1f} mm"
        for layer, depth in zip(layers.sequence[1:], layers.boundaries, strict=True)
    )
    yield "layer crossings", into, reconstruction.patient.to_local(layers.points), _BAND
    if reconstruction.markers is not None:
        yield "markers", marker_names(reconstruction), reconstruction.markers.centers, _MARKER


def marker_names(reconstruction: Reconstruction) -> tuple[str, ...]:
    """Return what each marker found is: the known one that it was paired with, counted from 0, or none."""
    markers, registration = reconstruction.markers, reconstruction.registration
    if markers is None:
        return ()
    paired = {} if registration is None else {int(found): int(known) for found, known in registration.pairs}
    return tuple(
        f"marker {paired[n]}" if n in paired else f"found {n}, no known marker"
        for n in range(len(markers.centers))
    )


def _bodies(reconstruction: Reconstruction, diameter: float) -> Iterator[tuple[str, Floats, Floats]]:
    """Yield the name, axis (K, 3) and half widths (K, 2) of each body."""
    whole = reconstruction.needle_axis.points
    yield "needle", whole, np.full((len(whole), 2), diameter / 2)
    wide = diameter / 2 + _NINETY_FIVE * reconstruction.sd
    yield "band", _inserted(reconstruction), np.column_stack([wide, wide])


def _inserted(reconstruction: Reconstruction) -> Floats:
    """Return the centreline from first contact to tip in the scan (N, 3), LPS, mm."""
    return reconstruction.patient.to_local(reconstruction.points)


def _toward(reconstruction: Reconstruction) -> Floats:
    """Return C's y axis in the scan, LPS (3,)."""
    toward: Floats = reconstruction.patient.rotation.T @ reconstruction.frame.rotation[:, 1]
    return toward


def _labels(s: Floats) -> tuple[str, ...]:
    """Return what stands at each point: its distance from the entry; the ends say which they are."""
    last = len(s) - 1
    nearest = int(np.argmin(np.abs(s)))
    named = {nearest: "entry", last: "tip"} if abs(s[nearest]) < 1e-6 else {0: "base", last: "tip"}
    return tuple(named.get(n, f"{distance:.1f} mm") for n, distance in enumerate(s))
