"""Needles for 3D Slicer: curves as `.mrk.json` and bodies as `.ply`, LPS, mm."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.formats.markups import Markups
from needlefit.datasets.formats.mrk_json import CurveStyle, write_mrk_json
from needlefit.errors import ConfigError
from needlefit.geometry.curves import arc_length
from needlefit.geometry.frames import Placement
from needlefit.geometry.meshes import make_tube, write_ply
from needlefit.mechanics.shape import NeedleShape, compute_positions
from needlefit.project.outputs import require_folder
from needlefit.reporting.names import METHOD_COLOURS, PAPER, rgb
from needlefit.validation.needles_in_scan import DEFAULT_DIAMETER_MM, Band, NeedleInScan
from needlefit.validation.results import Results

Floats = NDArray[np.float64]

THICK, THIN = 0.6, 0.3
"""Lines of needles and of the edges of bands, mm."""

BEFORE, INSERTED = 25, 51
"""Points of a simulated needle before its entry into the tissue, and from there on."""

_MEASURED, _FITTED, _BAND = PAPER, METHOD_COLOURS["fitted"], METHOD_COLOURS["linear_curvature"]


def write_needles(results: Results, folder: Path) -> None:
    """Write every needle of a run, in the patient coordinates of its scan, to `folder`.

    `<id>.mrk.json` holds curves: measured, fitted (predicted where the fit never saw it), and the edges of
    the 95 % band, of a posterior its median too. `<id>.needle.ply` is the fitted needle's body,
    `<id>.band.ply` the space that it takes when it goes through the band.
    """
    folder.mkdir(exist_ok=True)
    said = " (synthetic)" if results.origin == "synthetic" else ""
    for needle in results.needles.values():
        write_mrk_json(folder / f"{needle.insertion}.mrk.json", _curves(needle, said))
        for name, points, widths in _bodies(needle):
            doubt = ", NOT CONVERGED" if name == "band" and _unconverged(needle) else ""
            comments = (f"needlefit: {needle.insertion}, {name}{said}{doubt}, mm",)
            body = make_tube(points, widths, needle.toward)
            write_ply(body, folder / f"{needle.insertion}.{name}.ply", comments)


def write_scene(
    placement: Placement, shapes: Sequence[NeedleShape], path: Path, diameter: float | None = None
) -> bool:
    """Write a simulated needle, from its base to its tip, in the patient coordinates in which it lies.

    A `.mrk.json` holds a curve for every step, a `.ply` the body after the last; a step that failed is left
    out. Return whether there was any to write.

    Raises
    ------
    ConfigError
        If the ending of `path` is another one or its folder does not exist.
    """
    _check(path)
    curves = [_simulated(placement, shape) for shape in shapes if shape.converged]
    if not curves:
        return False
    if path.suffix.lower() == ".ply":
        radius = (DEFAULT_DIAMETER_MM if diameter is None else diameter) / 2
        write_ply(make_tube(curves[-1][0], radius, placement.across), path)
        return True
    steps = [f"needle, step {n}" for n in range(1, len(curves) + 1)] if len(shapes) > 1 else ["needle"]
    lists = [
        Markups(path, f"{name}, {shape.depth:g} mm deep", "Curve", _labels(s), points)
        for name, shape, (points, s) in zip(steps, shapes, curves, strict=False)
    ]
    write_mrk_json(path, [(one, CurveStyle(rgb(_FITTED), THICK)) for one in lists])
    return True


def _unconverged(needle: NeedleInScan) -> bool:
    """Whether the band is drawn from a posterior that has not converged."""
    return needle.band is not None and not needle.band.converged


def _curves(needle: NeedleInScan, said: str) -> Iterator[tuple[Markups, CurveStyle]]:
    found = "predicted" if needle.role == "validate" else "fitted"
    lines = [("measured", needle.measured, _MEASURED, THICK)]
    if needle.fitted is not None:
        lines.append((found, needle.fitted, _FITTED, THICK))
    if needle.band is not None:
        lines += _edges(needle.band)
    for name, points, colour, thickness in lines:
        labels = _labels(arc_length(points))
        path = Path(needle.insertion)
        curve = Markups(path, f"{needle.insertion} {name}{said}", "Curve", labels, points)
        yield curve, CurveStyle(rgb(colour), thickness)


def _edges(band: Band) -> Iterable[tuple[str, Floats, str, float]]:
    source = band.source if band.converged else f"{band.source}, NOT CONVERGED"
    if band.source == "posterior":
        yield source.replace("posterior", "posterior median", 1), band.middle, _BAND, THICK
    yield f"95 % band, low, {source}", band.low, _BAND, THIN
    yield f"95 % band, high, {source}", band.high, _BAND, THIN


def _bodies(needle: NeedleInScan) -> Iterator[tuple[str, Floats, Floats]]:
    """Yield the name, axis (K, 3) and half widths (K, 2) of each body: in its plane, and across it."""
    radius = needle.diameter / 2
    if needle.fitted is not None:
        yield "needle", needle.fitted, np.array([radius, radius])
    if needle.band is not None:
        half = np.linalg.norm(needle.band.high - needle.band.low, axis=1) / 2
        axis = (needle.band.high + needle.band.low) / 2
        yield "band", axis, np.column_stack([half + radius, np.full(len(half), radius)])


def _simulated(placement: Placement, shape: NeedleShape) -> tuple[Floats, Floats]:
    """Return points (K, 3) from base to tip, LPS, and their distances from the entry (K,), mm."""
    before = np.linspace(shape.x[0], 0.0, BEFORE) if shape.x[0] < 0 else np.zeros(1)
    inserted = np.linspace(0.0, shape.depth, INSERTED)[1:] if shape.depth > 0 else np.empty(0)
    s = np.concatenate([before, inserted])
    return placement.to_patient(compute_positions(shape, s)), s


def _labels(s: Floats) -> tuple[str, ...]:
    """Return what stands at each point: its distance from the entry; the ends say which they are."""
    ends = {int(np.argmin(np.abs(s))): "entry", len(s) - 1: "tip"}
    return tuple(ends.get(n, f"{distance:.1f} mm") for n, distance in enumerate(s))


def _check(path: Path) -> None:
    if not path.name.lower().endswith((".mrk.json", ".ply")):
        raise ConfigError(
            f"cannot write a `{path.suffix}` file for 3D Slicer",
            where=str(path),
            expected="a name that ends in .mrk.json or .ply",
            fix=f"write to {path.stem or 'needle'}.mrk.json",
        )
    require_folder(path)
