"""A scan under examination: what was found, what a person corrected, and what came of it."""

import shlex
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import DataError, NeedlefitError
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.imaging.assembly import DatasetDescription, assemble_checked
from needlefit.imaging.findings import list_entries, list_tubes, place_entries
from needlefit.imaging.needle.segmentation import median_tissue_hu
from needlefit.imaging.reconstruct import Examination, examine
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.registration.rigid import MIN_MARKERS
from needlefit.imaging.scans import Scan, write_scan_table
from needlefit.imaging.volume import Volume, grid_to_json
from needlefit.imaging.volume_files import read_volume
from needlefit.reporting.figures.scan_views import encode_grey
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.viewer.scans.corrections import Corrections, correct_scan, read_corrections
from needlefit.viewer.scans.slices import (
    HALF_WIDTH_MM,
    PIXEL_MM,
    NeedleCourse,
    cut_slice,
    list_slice_axes,
    make_course,
)

TABLE_FILE, RECIPE_FILE = "scans.csv", "recipe.toml"

SHOWN_POINTS = 60
"""Points of a line that are sent to the page."""

TISSUE_WINDOW_HU = 350.0
"""Half the width of the window that shows tissue, HU."""

MAX_HU = 3071.0
"""Brightest value of the window that shows metal, HU."""


class ScanSession:
    """A scan, examined once and again after every correction.

    Parameters
    ----------
    recipe_file : Path
        From which `recipe` was read; it is saved beside corrections.
    folder : Path
        Where corrections are saved: a table of this one scan, and the files that it names. Where it exists
        already, that of an earlier session or of another scan, a numbered one beside it is taken.

    Attributes
    ----------
    unsaved : bool
        Whether corrections are in use that were not saved.
    """

    def __init__(self, scan: Scan, recipe: ReconstructionRecord, recipe_file: Path, folder: Path) -> None:
        self.scan, self.recipe, self._recipe_file = scan, recipe, recipe_file
        self._folder, self.unsaved = folder, False
        self._saved_to: Path | None = None
        self.volume: Volume = read_volume(scan.volume, scan.series)
        self.axes = list_slice_axes(self.volume)
        self.corrections = Corrections()
        self.found = self._first = self._examine_as_written(scan)
        self.course = self._make_course()

    def again(self, content: object) -> None:
        """Examine the scan again, with the corrections that a page sent.

        Raises
        ------
        DataError
            If a correction is no place, or balls are given to a scan without markers.
        """
        given = read_corrections(content)
        self.found = self._examine(given) if given.any else self._first
        self.corrections = given
        self.course, self.unsaved = self._make_course(), given.any

    def save_shown(self, content: object) -> Path:
        """Save the corrections in use, as `save`, if they are those that a page shows.

        Raises
        ------
        DataError
            If another window has changed them.
        """
        if read_corrections(content).to_json() != self.corrections.to_json():
            raise DataError(
                "the corrections were changed in another window",
                expected="those that this page shows",
                fix="reload the page",
            )
        return self.save()

    def save(self) -> Path:
        """Write the corrected scan as a table of scans; return its path. Replaces what this session saved."""
        folder = self._saved_to or _make_new_folder(self._folder)
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / TABLE_FILE
        write_scan_table([correct_scan(self.scan, self.corrections, folder)], path)
        shutil.copyfile(self._recipe_file, folder / RECIPE_FILE)
        self._saved_to, self.unsaved = folder, False
        return path

    def keep_unsaved(self) -> Path | None:
        """Write corrections that nobody saved beside those that somebody did; return the table's path."""
        if not self.unsaved:
            return None
        self._saved_to = None
        return self.save()

    def command(self, table: Path) -> str:
        """Return the command that repeats what was done."""
        recipe, out = str(table.with_name(RECIPE_FILE)), f"{table.parent.name}_dataset"
        return shlex.join(["needlefit", "reconstruct", str(table), "--recipe", recipe, "--out", out])

    def cut(self, request: Mapping[str, Any]) -> bytes:
        """Return a slice as PNG.

        Raises
        ------
        DataError
            If there is no such slice.
        """
        try:
            low, high = float(request["low"]), float(request["high"])
            if request["view"] == "needle":
                if self.course is None:
                    raise DataError("no needle was found: there is no slice along it")
                values = self.course.cut(self.volume, np.radians(float(request["angle"])))
            else:
                axes = next(one for one in self.axes if one.name == request["view"])
                values = cut_slice(self.volume, axes, int(request["index"]))
        except (KeyError, ValueError, TypeError, StopIteration, OverflowError):
            raise DataError("there is no such slice", expected="view, index or angle, low, high") from None
        return encode_grey(values, low, max(high, low + 1.0))

    def describe(self) -> dict[str, Any]:
        """Return everything that the page shows, as JSON values; lengths in mm, places LPS."""
        found, volume = self.found, self.volume
        tissue = median_tissue_hu(volume)
        return {
            "id": self.scan.id,
            "volume": self.scan.volume.name,
            "synthetic": self.scan.origin == "synthetic",
            "grid": grid_to_json(volume.grid),
            "views": [vars(one) for one in self.axes],
            "windows": {
                "tissue": [tissue - TISSUE_WINDOW_HU, tissue + TISSUE_WINDOW_HU],
                "metal": [-1000.0, MAX_HU],
            },
            "error": _describe_error(found.error),
            "warnings": list(found.reconstruction.warnings if found.reconstruction else volume.warnings),
            "tubes": self._describe_tubes(),
            "entries": self._describe_entries(),
            "axis": None if found.needle_axis is None else _thin(found.needle_axis.points).tolist(),
            "tip": self._describe_tip(),
            "contact": self._describe_contact(),
            "balls": self._describe_balls(),
            "layers": _describe_layers(found),
            "proposed": _describe_proposals(found.reconstruction),
            "inserted": _describe_inserted(found.reconstruction),
            "course": self._describe_course(),
            "corrections": self.corrections.to_json(),
            "has_markers": self.scan.markers is not None,
            "min_balls": MIN_MARKERS,
            "entry_stated": self.scan.stage is not None,
        }

    def _examine(self, given: Corrections) -> Examination:
        with TemporaryDirectory(prefix="needlefit-") as name:
            found = self._examine_as_written(correct_scan(self.scan, given, Path(name)))
            if found.error is not None and found.error.where.startswith(name):
                return replace(found, error=found.error.at("balls placed by hand"))
            return found

    def _examine_as_written(self, scan: Scan) -> Examination:
        """Return what is found in a scan; what a dataset may not hold is refused, as when it is written."""
        found = examine(self.volume, scan, self.recipe)
        if found.reconstruction is None:
            return found
        with TemporaryDirectory(prefix="needlefit-") as folder:
            about = DatasetDescription(scan.id)
            _, refused = assemble_checked(Path(folder), [found.reconstruction], self.recipe, about)
        return replace(found, reconstruction=None, error=refused[0].error) if refused else found

    def _make_course(self) -> NeedleCourse | None:
        axis = self.found.needle_axis
        return None if axis is None else make_course(axis.points)

    def _describe_tubes(self) -> list[dict[str, Any]]:
        lines = []
        for one in list_tubes(self.volume, self.recipe, self.found.selection):
            about = {"length": one.length, "width": one.width, "chosen": one.chosen}
            lines.append({**about, "line": one.ends.tolist(), "middle": one.ends.mean(axis=0).tolist()})
        return lines

    def _describe_entries(self) -> list[dict[str, Any]]:
        axis = self.found.needle_axis
        if axis is None:
            return []
        entries = list_entries(axis, self.found.profile)
        places = place_entries(axis.points, entries)
        return [
            {"depth": one.depth, "sd": one.sd, "change": one.change, "at": at.tolist()}
            for one, at in zip(entries, places, strict=True)
        ]

    def _describe_tip(self) -> dict[str, Any] | None:
        axis = self.found.needle_axis
        if axis is None:
            return None
        along, across = axis.tip_sd.tolist()
        placed = self.found.scan.tip is not None
        return {"at": axis.tip.tolist(), "along_sd": along, "across_sd": across, "placed": placed}

    def _describe_contact(self) -> dict[str, Any] | None:
        one = self.found.reconstruction
        if one is None:
            return None
        at = one.patient.to_local(one.points[:1])[0]
        placed = self.found.scan.contact is not None
        return {"at": at.tolist(), "along_sd": one.pose.along_sd, "source": one.pose.source, "placed": placed}

    def _describe_balls(self) -> list[dict[str, Any]]:
        markers, registration = self.found.markers, self.found.registration
        if markers is None:
            return []
        missed: dict[int, float] = {}
        if registration is not None:
            lengths = np.linalg.norm(registration.residuals, axis=1)
            missed = dict(zip(registration.pairs[:, 0].tolist(), lengths.tolist(), strict=True))
        return [
            {"at": center.tolist(), "sd": float(sd), "residual": missed.get(n), "source": markers.source}
            for n, (center, sd) in enumerate(zip(markers.centers, markers.sd, strict=True))
        ]

    def _describe_course(self) -> dict[str, Any] | None:
        course = self.course
        if course is None:
            return None
        parts = {name: np.round(getattr(course, name), 4).tolist() for name in ("points", "u", "v")}
        return {**parts, "rows": len(course.aside), "pixel": PIXEL_MM, "half_width": HALF_WIDTH_MM}


def _make_new_folder(folder: Path) -> Path:
    """Make a folder that was not there, of this name or with a number behind it; return it."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    new, number = folder, 1
    while True:
        try:
            new.mkdir()
        except FileExistsError:
            number += 1
            new = folder.with_name(f"{folder.name}-{number}")
        else:
            return new


def _thin(points: Floats) -> Floats:
    kept = np.unique(np.linspace(0, len(points) - 1, SHOWN_POINTS).round().astype(np.int64))
    return points[kept]


def _describe_error(error: NeedlefitError | None) -> dict[str, str] | None:
    if error is None:
        return None
    return {"what": error.what, "where": error.where, "expected": error.expected, "fix": error.fix}


def _describe_layers(found: Examination) -> list[dict[str, Any]]:
    one = found.reconstruction
    if one is None:
        return []
    places = one.patient.to_local(one.layers.points.reshape(-1, 3))
    crossed = zip(one.layers.boundaries, one.layers.sd, places, strict=True)
    return [{"depth": float(depth), "sd": float(sd), "at": at.tolist()} for depth, sd, at in crossed]


def _describe_proposals(one: Reconstruction | None) -> list[dict[str, Any]]:
    """Return the interfaces that the scan shows; none where nobody asked for them."""
    rows = []
    for found in () if one is None else one.proposals or ():
        assert one is not None
        world = interpolate_at_arc(one.points, np.array([found.at]))
        depth, at = float(one.frame.to_local(world)[0, 0]), one.patient.to_local(world)[0]
        rows.append({"depth": depth, "sd": found.sd, "step": found.step, "at": at.tolist()})
    return rows


def _describe_inserted(one: Reconstruction | None) -> dict[str, float] | None:
    if one is None:
        return None
    return {"depth": one.depth, "sd": one.depth_sd, "length": float(arc_length(one.needle_axis.points)[-1])}
