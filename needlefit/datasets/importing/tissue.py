"""Decide where imported needles enter the tissue, and its layers."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.faults import as_error
from needlefit.datasets.importing.curve_tables import ImportedCurve
from needlefit.datasets.importing.decisions import (
    Decisions,
    Question,
    Source,
    parse_depths,
    parse_not_negative,
)
from needlefit.datasets.importing.slicer_scene import ImportedSurface
from needlefit.datasets.insertion_faults import SAME_POINT_MM
from needlefit.datasets.layers import find_surface_faults
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.crossings import find_surface_hits
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.frames import normalize
from needlefit.geometry.surfaces import Surface, SurfaceKind

ENTRY_SPREAD = 0.3
"""Scatter of one end along the needles, as a part of that of the other end, below which it is the entry."""

SURFACE_SD_MM, DEPTH_SD_MM = 0.2, 0.5
"""Standard deviations that are assumed of boundaries given as surfaces, and as depths."""

_TISSUE_NAME = re.compile(r"skin|tissue|surface|outer|phantom|block|haut|entry", re.IGNORECASE)


@dataclass(frozen=True)
class Cut:
    """A curve from the tissue's surface on, and its points (K, 3) before it."""

    curve: ImportedCurve
    shaft: Floats


@dataclass(frozen=True)
class ImportedLayers:
    """Boundaries between the layers: surfaces in the world, or depths along the needle, mm; their SD, mm."""

    surfaces: tuple[Surface, ...] = ()
    depths_mm: tuple[float, ...] = ()
    sd_mm: float = 0.0


def decide_kind(one: ImportedSurface, decisions: Decisions) -> ImportedSurface:
    surface = one.surface
    kind: SurfaceKind = "solid" if surface.mesh.is_watertight else "sheet"
    decisions.keep(f"surface {surface.name}", kind, "guess", "closed" if kind == "solid" else "open")
    surface = replace(surface, kind=kind)
    if faults := list(find_surface_faults(surface, one.path)):
        raise as_error(faults, one.path)
    return replace(one, surface=surface)


def decide_entry(
    curves: list[ImportedCurve], surfaces: Sequence[Surface], decisions: Decisions
) -> list[ImportedCurve]:
    """Return the curves with their entry first."""
    guess, source, reason = _guess_entry([one.points.values for one in curves], surfaces)
    question = Question("entry", "Which end of the curves is the entry", ("first", "last"))
    if decisions.settle(question, guess, source, reason) == "first":
        return curves
    return [replace(one, points=one.points.part(np.arange(len(one.points.values))[::-1])) for one in curves]


def _guess_entry(curves: Sequence[Floats], surfaces: Sequence[Surface]) -> tuple[str, Source, str]:
    solids = [one for one in surfaces if one.kind == "solid"]
    if solids:
        ends = np.array([[_is_inside(curve[n], solids) for n in (0, -1)] for curve in curves])
        first, last = int((ends[:, 1] & ~ends[:, 0]).sum()), int((ends[:, 0] & ~ends[:, 1]).sum())
        if max(first, last) > len(curves) / 2:
            end = "first" if first > last else "last"
            return (
                end,
                "guess",
                f"the {end} points of {max(first, last)} of {len(curves)} curves are outside the solids",
            )
    chords = np.array([normalize(curve[-1] - curve[0]) for curve in curves if (curve[-1] != curve[0]).any()])
    mean = chords.mean(axis=0) if len(chords) else np.zeros(3)
    if len(curves) > 2 and np.linalg.norm(mean) > 0.9:
        spread = [float(np.std([curve[n] @ mean for curve in curves])) for n in (0, -1)]
        end = "first" if spread[0] < spread[1] else "last"
        if min(spread) < ENTRY_SPREAD * max(spread):
            return (
                end,
                "guess",
                f"along the needles the {end} points scatter by {min(spread):.2g} mm, "
                f"the others by {max(spread):.2g} mm",
            )
    return "first", "assumption", "the order of the file"


def _is_inside(point: Floats, solids: Sequence[Surface]) -> bool:
    with np.errstate(over="ignore"):
        return any(bool(one.mesh.contains([point])[0]) for one in solids)


def decide_tissue(
    curves: Sequence[ImportedCurve], surfaces: Sequence[Surface], decisions: Decisions
) -> Surface | None:
    """Return the surface of the tissue as a whole, at which needles enter; None where there is none."""
    if not surfaces:
        return None
    lines = [one.points.values for one in curves]
    hit = {one.name: [find_surface_hits(line, one) for line in lines] for one in surfaces}
    crossed = [one for one in surfaces if sum(len(arcs) > 0 for arcs in hit[one.name]) > len(lines) / 2]
    crossed.sort(key=lambda one: float(np.median([arcs[0] for arcs in hit[one.name] if len(arcs)])))
    solids = [one for one in surfaces if one.kind == "solid"]
    outside = sum(not _is_inside(line[0], solids) for line in lines) if solids else 0
    guess, reason = "none", "no surface is entered from outside by most needles"
    if crossed and (crossed[0].kind == "solid" and outside > len(lines) / 2):
        guess, reason = crossed[0].name, "the first solid that most needles enter from outside"
    elif crossed and _TISSUE_NAME.search(crossed[0].name):
        guess, reason = crossed[0].name, "its name, and most needles meet it first"
    names = ("none", *(one.name for one in surfaces))
    name = decisions.settle(
        Question("tissue surface", "Surface at which needles enter the tissue", names), guess, "guess", reason
    )
    return next((one for one in surfaces if one.name == name), None)


def cut_at_tissue(curve: ImportedCurve, tissue: Surface | None) -> Cut:
    """Return a curve from where it enters the tissue, with the points before."""
    points = curve.points
    arcs = find_surface_hits(points.values, tissue) if tissue is not None else np.empty(0)
    if len(arcs) == 0:
        return Cut(curve, np.empty((0, 3)))
    along = arc_length(points.values)
    after = np.flatnonzero(along > arcs[0] + 10 * SAME_POINT_MM)
    entry = interpolate_at_arc(points.values, arcs[:1])
    if len(after) < 4:
        raise DataError(
            f"curve {curve.name!r} has only {len(after)} points behind the tissue surface",
            where=points.where(),
            expected="a curve from the entry to the tip",
            fix="state another --tissue-surface (or none), or --entry last if the tip comes first",
        )
    kept = points.part(np.concatenate([after[:1], after]))
    values = np.vstack([entry, points.values[after]])
    return Cut(replace(curve, points=replace(kept, values=values)), points.values[along < arcs[0]])


def decide_layers(cuts: Sequence[Cut], surfaces: Sequence[Surface], decisions: Decisions) -> ImportedLayers:
    """Return the layers: behind surfaces, or behind boundaries that are stated as depths along the needle.

    Raises
    ------
    ConfigError
        If both are given, or the depths do not increase.
    """
    question = Question(
        "boundaries", "Depths of the boundaries between layers along the needles, mm (such as 15,30), or none"
    )
    if surfaces and question.what in decisions.options:
        raise ConfigError(
            "boundaries are stated, and the files hold surfaces of layers",
            expected="one of the two",
            fix="leave --boundaries out, or the files of the surfaces",
        )
    if surfaces:
        numbered = _number_layers([cut.curve for cut in cuts], surfaces, decisions)
        sd = _decide_boundary_sd(SURFACE_SD_MM, "that of a surface segmented in a CT scan", decisions)
        return ImportedLayers(tuple(numbered), (), sd)
    text = decisions.settle(question, "none", "guess", "no surfaces in the files: one layer")
    if text == "none":
        return ImportedLayers()
    depths = parse_depths(question.what, text)
    return ImportedLayers((), depths, _decide_boundary_sd(DEPTH_SD_MM, "that of a ruler", decisions))


def _decide_boundary_sd(default: float, reason: str, decisions: Decisions) -> float:
    question = Question("boundary sd", "Standard deviation of the depths of the boundaries, mm")
    return parse_not_negative(question.what, decisions.settle(question, f"{default:g}", "assumption", reason))


def _number_layers(
    curves: Sequence[ImportedCurve], surfaces: Sequence[Surface], decisions: Decisions
) -> list[Surface]:
    """Return the surfaces with the layers that they lead into, in the order in which needles meet them.

    A solid in which most needles begin is layer 1, which needs no surface.
    """
    lines = [one.points.values for one in curves]
    starts = [
        one
        for one in surfaces
        if one.kind == "solid" and sum(_is_inside(line[1], [one]) for line in lines) > len(lines) / 2
    ]
    for one in starts:
        decisions.keep(f"layer of {one.name}", "1", "guess", "most needles begin in it")
    others = [(_find_mean_arc(lines, one), one) for one in surfaces if one not in starts]
    others.sort(key=lambda pair: pair[0])
    numbered = []
    for into, (arc, one) in enumerate(others, 2):
        reason = f"first met at {arc:.1f} mm on average" if np.isfinite(arc) else "met by no needle"
        decisions.keep(f"layer of {one.name}", str(into), "guess", reason)
        numbered.append(replace(one, into=into))
    return numbered


def _find_mean_arc(lines: Sequence[Floats], surface: Surface) -> float:
    arcs = [hits[0] for line in lines if len(hits := find_surface_hits(line, surface))]
    return float(np.mean(arcs)) if arcs else np.inf
