"""Correct scans by control points that a person moved in 3D Slicer.

Of every scan one list of control points is written: some on the needle's axis, the tip, the entry and the
balls. The description of a point says where it was found, so that a list alone shows which were moved.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.formats.markups import Markups, read_markups
from needlefit.errors import DataError, located
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.imaging.constants import MM
from needlefit.imaging.reconstruction import MarkerResult, Reconstruction
from needlefit.imaging.scans import Corrections, Scan, find_owner

LIST_NAME = "corrections"  # name of a list of control points, after the id of its scan
AXIS_POINTS = 8  # number of control points on the needle, at even distances
KINDS = ("axis", "tip", "entry", "ball")
_LABEL = re.compile(rf"\s*({'|'.join(KINDS)})\s*\d*\s*", re.IGNORECASE)
# with the number of balls: one that was removed is missed by the others
_FOUND = re.compile(
    r"found at L, P, S = (-?\d+\.\d+), (-?\d+\.\d+), (-?\d+\.\d+) mm(?:, one of (\d+) balls)?"
)


def make_control_points(
    id_: str, needle: Floats, entry: Floats | None, markers: MarkerResult | None
) -> Markups:
    """Return the control points of a scan, LPS.

    `needle`: (N, 3); its axis from base to tip, mm.
    `entry`: (3,) or None; where it enters the tissue.
    """
    balls = np.empty((0, 3)) if markers is None else markers.centers
    middles = arc_length(needle)[-1] * (np.arange(AXIS_POINTS) + 0.5) / AXIS_POINTS
    points = {f"axis {n}": place for n, place in enumerate(interpolate_at_arc(needle, middles), 1)}
    points["tip"] = needle[-1]
    if entry is not None:
        points["entry"] = entry
    points |= {f"ball {n}": ball for n, ball in enumerate(balls, 1)}
    places = np.array([*points.values()]).round(3)
    named = tuple(
        "found at L, P, S = {:.3f}, {:.3f}, {:.3f} mm".format(*place)
        + f", one of {len(balls)} balls" * label.startswith("ball")
        for label, place in zip(points, places.tolist(), strict=True)
    )
    return Markups(Path(id_), f"{id_} {LIST_NAME}", "Fiducial", tuple(points), places, descriptions=named)


def list_control_points(reconstruction: Reconstruction) -> Markups:
    """Return the control points by which a reconstruction is corrected, LPS."""
    (entry,) = reconstruction.patient.to_local(reconstruction.points[:1])
    needle, markers = reconstruction.needle_axis.points, reconstruction.markers
    return make_control_points(reconstruction.scan.id, needle, entry, markers)


def read_corrections(path: Path) -> dict[str, Corrections]:
    """Return the corrections in a `.mrk.json` file, by the id of the scan.

    A point that stands where it was found is none; one that was added is. Moved points of the axis count
    alone; if one ball was moved, added or removed, all balls of the list are the markers.

    DataError if the file is none of 3D Slicer, or a list or a point in it has another name.
    """
    corrections: dict[str, Corrections] = {}
    for markup in read_markups(path):
        id_, name, _ = markup.name.rpartition(f" {LIST_NAME}")
        if not name or markup.kind != "Fiducial":
            raise DataError(
                f"the {markup.kind} `{markup.name}` is no list of corrections",
                expected=(
                    f"the point list `ID {LIST_NAME}` that `needlefit reconstruct` wrote for the scan ID"
                ),
                fix="save that list alone",
                where=path,
            )
        with located(f"{path}, list `{markup.name}`"):
            corrections[id_] = _parse_corrections(markup)
    return corrections


def _parse_corrections(markups: Markups) -> Corrections:
    named = [_LABEL.fullmatch(label) for label in markups.labels]
    if unknown := [label for label, match in zip(markups.labels, named, strict=True) if match is None]:
        raise DataError(
            f"points are called {', '.join(f'`{label}`' for label in unknown)}",
            expected=f"{', '.join(KINDS)}, with or without a number",
            fix="rename the points in 3D Slicer, or remove them",
        )
    kinds = np.array([match[1].lower() for match in named if match])
    stated = [_FOUND.search(text) for text in markups.descriptions]
    found = np.array([match.groups("nan") if match else 4 * ("nan",) for match in stated], dtype=np.float64)
    moved = ~(np.linalg.norm(markups.points - found[:, :3], axis=1) <= MM.GRID_SD)  # what was added, too
    axis, tip, entry, balls = (markups.points[(kinds == kind) & moved] for kind in KINDS)
    if max(len(tip), len(entry)) > 1:
        raise DataError(
            f"{len(tip)} points are the tip, {len(entry)} the entry",
            expected="one of each at most",
            fix="remove the others",
        )
    counts = found[np.isfinite(found[:, 3]), 3]
    changed = len(balls) or len(counts) < counts.max(initial=0)
    return Corrections(
        axis=axis if len(axis) else None,
        tip=next(iter(tip), None),
        entry=next(iter(entry), None),
        balls=markups.points[kinds == "ball"] if changed else None,
    )


def correct_scans(scans: Sequence[Scan], files: Sequence[Path], every: bool = False) -> tuple[Scan, ...]:
    """Return the scans with the corrections that files hold for them.

    `every`: whether each needle of a scan, `ID-1`, ..., may be corrected.

    DataError as `read_corrections`; if no point of a list was moved, and nothing was confirmed; if a scan has
    none of that id, corrections in two files, balls but no known places of markers, or an entry beside that
    of the stage.
    """
    corrected = {scan.id: scan for scan in scans}
    for path in files:
        for id_, correction in read_corrections(path).items():
            owner = find_owner(id_, corrected, every)
            scan = corrected.get(owner)
            if scan is None:
                problem = f"is not among {', '.join(corrected)}"
                fix = "name that scan, too, or give --all for one needle of several"
            elif id_ in scan.corrections:
                problem = "is corrected a second time"
                fix = "leave out one of its lists"
            elif not (scan.answers or any(places is not None for places in vars(correction).values())):
                problem = "none of its control points was moved"
                fix = "move what is wrong in 3D Slicer and save the list; --confirm takes an entry as it is"
            elif correction.balls is not None and scan.markers is None:
                problem = "its balls were moved, but no known places of markers are stated"
                fix = "add --markers, or leave the balls where they were"
            elif correction.entry is not None and scan.stage is not None:
                problem = "its entry was moved, but the stage (entry_x_mm ...) states it"
                fix = "leave the entry where it was, or leave out the stage"
            else:
                corrected[owner] = replace(scan, corrections={**scan.corrections, id_: correction})
                continue
            raise DataError(f"the scan `{id_}`: {problem}", fix=fix, where=path)
    return tuple(corrected.values())
