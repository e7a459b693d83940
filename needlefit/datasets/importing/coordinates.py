"""Decide the unit, the order and the frame of imported curves and surfaces."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.importing.curve_tables import UNITS_MM, ImportedCurve
from needlefit.datasets.importing.decisions import Decisions, Question
from needlefit.datasets.importing.slicer_scene import ImportedSurface
from needlefit.datasets.insertion_faults import MIN_POINTS, SAME_POINT_MM
from needlefit.errors import DataError
from needlefit.geometry.crossings import find_surface_hits
from needlefit.geometry.curves import arc_length
from needlefit.geometry.frames import RAS_TO_LPS, to_lps
from needlefit.geometry.surfaces import Surface, transform_surface

LENGTHS_MM = (20.0, 1000.0)
"""Length of the longest needle of a dataset, least and most, by which a unit is guessed."""

UNCLEAR_UNITS = ((2.0, 20.0), (1000.0, 20_000.0))
"""Lengths in the file, from and to, at which more than one unit is plausible."""


def convert_units(curves: Sequence[ImportedCurve], decisions: Decisions) -> list[ImportedCurve]:
    """Return the curves in mm; where files state no unit, the longest curve decides."""
    unknown = [one for one in curves if not one.unit]
    stated = sorted({one.unit for one in curves if one.unit})
    question = Question("units", "Unit of the coordinates", tuple(UNITS_MM))
    if not unknown:
        decisions.keep("units", ", ".join(stated), "file", "header or format")
        unit = ""
    else:
        longest = max(float(arc_length(one.points.values)[-1]) for one in unknown)
        guess, is_clear = _guess_unit(longest)
        reason = f"the longest curve is {longest:.4g} long, {longest * UNITS_MM[guess]:.4g} mm in {guess}"
        unit = decisions.settle(question, guess, "guess", reason, is_clear)
    return [_scaled(one, UNITS_MM[one.unit or unit]) for one in curves]


def _guess_unit(longest: float) -> tuple[str, bool]:
    """Return the unit in which a needle of this length is plausible, and whether it is the only one."""
    is_clear = not any(low <= longest < high for low, high in UNCLEAR_UNITS)
    for unit in ("mm", "cm", "m", "um"):
        if LENGTHS_MM[0] <= longest * UNITS_MM[unit] <= LENGTHS_MM[1]:
            return unit, is_clear
    return "mm", False


def _scaled(curve: ImportedCurve, factor: float) -> ImportedCurve:
    points = curve.points
    sd = None if points.sd is None else factor * points.sd
    return replace(curve, points=replace(points, values=factor * points.values, sd=sd), unit="mm")


def drop_repeats(curve: ImportedCurve, decisions: Decisions) -> ImportedCurve:
    """Return a curve without points that repeat the one before."""
    steps = np.linalg.norm(np.diff(curve.points.values, axis=0), axis=1)
    keep = np.flatnonzero(np.concatenate([[True], steps >= SAME_POINT_MM]))
    count = len(steps) + 1 - len(keep)
    if not count:
        return curve
    if len(keep) < MIN_POINTS:
        raise DataError(
            f"curve {curve.name!r} has only {len(keep)} different points",
            where=curve.points.where(),
            expected=f"at least {MIN_POINTS}",
            fix="sample the needle more densely, or leave it out",
        )
    decisions.keep(
        f"points of {curve.name}", f"{count} repeated points left out", "guess", "equal to the point before"
    )
    return replace(curve, points=curve.points.part(keep))


def decide_frame(
    curves: list[ImportedCurve], surfaces: Sequence[ImportedSurface], decisions: Decisions
) -> tuple[list[ImportedCurve], list[Surface]]:
    """Return curves and surfaces in one frame; what states no system is tried as LPS and as RAS."""
    loose = [n for n, one in enumerate(curves) if one.system is None]
    loose_surfaces = [n for n, one in enumerate(surfaces) if one.system is None]
    meshes = [one.surface for one in surfaces]
    if len(loose) < len(curves):
        decisions.keep("frame", "LPS", "file", "the system that the curves' files state, converted to LPS")
    if loose:
        movable = bool(surfaces) and len(loose_surfaces) < len(surfaces)
        tried = _try_flips([curves[n].points.values for n in loose], meshes) if movable else None
        system = _settle_system("frame", "curves", tried, bool(surfaces), decisions)
        if system == "RAS":
            for n in loose:
                points = curves[n].points
                curves[n] = replace(curves[n], points=replace(points, values=to_lps(points.values, "RAS")))
    if loose_surfaces:
        tried = _try_flips([one.points.values for one in curves], [meshes[n] for n in loose_surfaces])
        if _settle_system("surfaces frame", "surfaces", tried, True, decisions) == "RAS":
            for n in loose_surfaces:
                meshes[n] = transform_surface(meshes[n], RAS_TO_LPS)
    return curves, meshes


def _try_flips(curves: Sequence[Floats], surfaces: Sequence[Surface]) -> tuple[int, int, int]:
    """Return how many curves meet a surface as given, how many with x and y changed, and of how many."""
    counts = [
        sum(any(len(find_surface_hits(curve, one)) for one in surfaces) for curve in some)
        for some in (curves, [to_lps(curve, "RAS") for curve in curves])
    ]
    return counts[0], counts[1], len(curves)


def _settle_system(
    what: str, noun: str, tried: tuple[int, int, int] | None, matters: bool, decisions: Decisions
) -> str:
    question = Question(what, f"Coordinate system of the {noun}", ("LPS", "RAS"))
    if tried is None and not matters and what not in decisions.options:
        decisions.keep(
            what, "as in the files", "file", "neither LPS nor RAS is stated, and nothing depends on it"
        )
        return "LPS"
    if tried is None:
        return decisions.settle(question, "LPS", "assumption", "not stated, and nothing to compare it with")
    as_given, flipped, count = tried
    reason = f"as LPS {as_given}, as RAS {flipped} of {count} curves meet the surfaces"
    if as_given == flipped:
        return decisions.settle(question, "LPS", "assumption", f"{reason}: not decided by the data")
    return decisions.settle(question, "LPS" if as_given > flipped else "RAS", "guess", reason)
