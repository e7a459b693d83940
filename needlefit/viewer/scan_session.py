"""A scan that is looked at and corrected by hand before it is reconstructed."""

import json
import shlex
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from needlefit.arrays import Floats
from needlefit.datasets.faults import as_error
from needlefit.errors import DataError, NeedlefitError
from needlefit.geometry.curves import arc_length, interpolate_at_arc, make_normal
from needlefit.imaging.assembly import DatasetDescription, assemble_checked
from needlefit.imaging.batch import TubeFinding, list_entries, list_tubes, place_entries
from needlefit.imaging.needle.follow import MIN_POINTS
from needlefit.imaging.needle.segmentation import median_tissue_hu
from needlefit.imaging.reconstruct import Examination, VolumeSearch, examine
from needlefit.imaging.registration.pairing import MIN_MARKERS
from needlefit.imaging.scans import Scan, placed_contact_fault, write_scan_table
from needlefit.imaging.volume import Volume, grid_to_json, to_index
from needlefit.imaging.volume_files import read_volume
from needlefit.project.toml import dumps
from needlefit.reporting.figures.scan_views import encode_grey
from needlefit.schemas.reconstruction import ReconstructionRecord

PIXEL_MM = 0.3  #: edge of a pixel of the slice along the needle, mm
HALF_WIDTH_MM = 10.0  #: how far the slice along the needle reaches to both sides, mm
BEYOND_TIP_MM = 15.0  #: how far it reaches beyond the tip, mm
_LETTERS = ("RL", "AP", "IS")  #: letters of the low and the high side of the patient's axes L, P, S
#: name, and the patient's axes across the slice, to the right and downwards; -1: upwards is positive
_VIEWS = (("axial", 2, 0, 1, 1), ("coronal", 1, 0, 2, -1), ("sagittal", 0, 1, 2, -1))


@dataclass(frozen=True)
class SliceAxes:
    """How a slice lies in a volume."""

    name: str
    normal: int  #: normal, right, down: axes of the volume: i, j or k
    right: int
    down: int
    right_sign: int  #: right_sign, down_sign: -1 where the picture runs against the index
    down_sign: int
    letters: tuple[str, str, str, str]  #: of the patient's sides at the left, right, top and bottom edge


def list_slice_axes(volume: Volume) -> tuple[SliceAxes, ...]:
    """Return the three views, each of the volume's axes taken for the patient's axis that it is nearest."""
    turned = volume.direction
    own = max(permutations(range(3)), key=lambda axes: sum(abs(turned[p, axes[p]]) for p in range(3)))
    signs = [1 if turned[p, own[p]] > 0 else -1 for p in range(3)]
    found = []
    for name, normal, right, down, way in _VIEWS:
        across, along = _LETTERS[right], _LETTERS[down][::way]
        found.append(
            SliceAxes(
                name, own[normal], own[right], own[down], signs[right], way * signs[down],
                (across[0], across[1], along[0], along[1]),
            )
        )  # fmt: skip
    return tuple(found)


def cut_slice(volume: Volume, axes: SliceAxes, index: int) -> NDArray[np.float32]:
    """Return one slice (rows, columns), top row first, HU."""
    order = {0: 2, 1: 1, 2: 0}  # values are stored [k, j, i]
    plane = np.moveaxis(volume.values, [order[axes.normal], order[axes.down], order[axes.right]], [0, 1, 2])
    index = min(max(index, 0), plane.shape[0] - 1)
    return plane[index, :: axes.down_sign, :: axes.right_sign]


@dataclass(frozen=True)
class NeedleCourse:
    """The needle drawn straight: where each column of its slice lies, and what is across it."""

    #: points, u, v: (N, 3) LPS, mm; `u` and `v` are perpendicular unit vectors across the needle
    points: Floats
    u: Floats
    v: Floats

    @property
    def aside(self) -> Floats:
        """Distance of each row from the needle, mm, the top row first."""
        return np.arange(HALF_WIDTH_MM, -HALF_WIDTH_MM - 1e-9, -PIXEL_MM)

    def cut(self, volume: Volume, angle: float) -> NDArray[np.float32]:
        """Return the slice (rows, N) through the needle, turned about it by `angle` (rad); nan outside."""
        across = np.cos(angle) * self.u + np.sin(angle) * self.v
        places = self.points[None] + self.aside[:, None, None] * across[None]
        index = to_index(volume, places.reshape(-1, 3))[:, ::-1].T
        values: NDArray[Any] = map_coordinates(volume.values, index, order=1, cval=np.nan, output=np.float32)
        return values.reshape(len(self.aside), len(self.points))


def make_course(needle: Floats) -> NeedleCourse:
    """Return the course of a needle (N, 3), LPS, from base to tip and on beyond it."""
    ahead = needle[-1] - needle[max(0, len(needle) - 10)]
    ahead /= np.linalg.norm(ahead)
    whole = np.vstack([needle, needle[-1] + BEYOND_TIP_MM * ahead])
    points = interpolate_at_arc(whole, np.arange(0.0, arc_length(whole)[-1], PIXEL_MM))
    tangents = np.gradient(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    # One normal for all: a needle bends by far less than the right angle at which this would fail.
    v = np.cross(tangents, make_normal(tangents[len(points) // 2]))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    return NeedleCourse(points, np.cross(v, tangents), v)


MAX_PLACES = 64  #: balls, or points on the needle, that may be placed by hand
BALLS_FILE, POINTS_FILE = "balls.csv", "needle.csv"
BALL_RANGE_MM = (0.3, 30.0)  #: diameters of balls that may be stated, mm
MAX_CANDIDATES = 8  #: things like balls, rejected, that the page lists
DIGITS = 3  #: decimals of a place, mm: as many as the files keep, so that these give the same numbers again


@dataclass(frozen=True)
class Corrections:
    """Places that a person gave, LPS, mm; None: as found."""

    needle: Floats | None = None  #: (3,) A point on the tube that is the needle
    points: Floats | None = None  #: (N, 3) points along the needle, instead of a tube
    balls: Floats | None = None  #: (M, 3) all balls
    contact: Floats | None = None  #: contact, tip: (3,) Where the needle enters the tissue, and where it ends
    tip: Floats | None = None
    ball_mm: float | None = None  #: diameter of the balls, mm

    @property
    def any(self) -> bool:
        return any(part is not None for part in vars(self).values())

    def to_json(self) -> dict[str, Any]:
        return {
            name: part.tolist() if isinstance(part, np.ndarray) else part for name, part in vars(self).items()
        }


def read_corrections(content: object) -> Corrections:
    """Return the corrections that a page sent; DataError if they are not places."""
    if not isinstance(content, Mapping):
        raise DataError(
            "the corrections are no table", expected="needle, points, balls, contact, tip, ball_mm"
        )
    read: dict[str, Any] = {}
    for name in ("points", "balls"):
        places = content.get(name)
        if places is not None:
            if not isinstance(places, Sequence) or isinstance(places, str) or len(places) > MAX_PLACES:
                raise DataError(f"{name} are no list of places", expected=f"at most {MAX_PLACES}, LPS, mm")
            read[name] = np.array([_read_point(one, f"one of {name}") for one in places]).reshape(-1, 3)
    for name in ("needle", "contact", "tip"):
        if (at := content.get(name)) is not None:
            read[name] = _read_point(at, name)
    if (size := content.get("ball_mm")) is not None:
        low, high = BALL_RANGE_MM
        if not _is_number(size) or not low <= size <= high:
            raise DataError(
                f"the balls' diameter is {json.dumps(size)[:60]}", expected=f"{low} to {high:g} mm"
            )
        read["ball_mm"] = float(size)
    return Corrections(**read)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e6


def _read_point(given: object, name: str) -> Floats:
    if not isinstance(given, Sequence) or len(given) != 3 or not all(map(_is_number, given)):
        raise DataError(f"{name} is {json.dumps(given)[:60]}", expected="three numbers, LPS, mm")
    return np.array([round(float(x), DIGITS) for x in given])


def correct_scan(scan: Scan, corrections: Corrections, folder: Path) -> Scan:
    """Return the scan with the corrections; the balls and points that it then names are written to `folder`.

    DataError if balls are given to a scan without markers, or too few, or an entry beside that of the stage.
    """
    balls, needle = corrections.balls, corrections.needle
    if balls is not None and scan.markers is None:
        raise DataError(
            "balls were placed, but the scan has no known places to lay them on",
            expected="the markers' known places in the world",
            fix="start the page with --markers FILE, or with a table of scans that names them",
        )
    if balls is not None and len(balls) < MIN_MARKERS:
        raise DataError(
            f"{len(balls)} of at least {MIN_MARKERS} balls are left",
            expected=f"{MIN_MARKERS} or more that are not on a line: they register the scan to the world",
            fix="add balls, or take the removal back",
        )
    if corrections.contact is not None and scan.stage is not None:
        raise as_error([placed_contact_fault(scan.id)], scan.volume)
    files: dict[str, Any] = {}
    for field, name, places in (("fiducials", BALLS_FILE, balls), ("mask", POINTS_FILE, corrections.points)):
        if places is not None:
            files[field] = folder / name
            lines = ["x_mm,y_mm,z_mm", *(",".join(f"{x:.{DIGITS}f}" for x in place) for place in places)]
            files[field].write_text("\n".join(lines) + "\n", encoding="utf-8")
    if needle is not None or corrections.points is not None:
        scan = replace(scan, mask=None, needle_at=needle)
    return replace(
        scan,
        **files,
        contact=scan.contact if corrections.contact is None else corrections.contact,
        tip=scan.tip if corrections.tip is None else corrections.tip,
    )


TABLE_FILE, RECIPE_FILE = "scans.csv", "recipe.toml"
SHOWN_POINTS = 60  #: points of a line that are sent to the page
TISSUE_WINDOW_HU = 350.0  #: half the width of the window that shows tissue, HU
MAX_HU = 3071.0  #: brightest value of the window that shows metal, HU


class ScanSession:
    """A scan, examined once and again after every correction.

    A correction with which the examination gets less far than without it is refused: what was found before
    stays, and `refusal` says why. Corrections are saved to `folder`: a table of this one scan, the files that
    it names, and the recipe. Where it exists already, a numbered one beside it is taken.
    """

    def __init__(self, scan: Scan, recipe: ReconstructionRecord, recipe_file: Path, folder: Path) -> None:
        self.scan, self.recipe, self._recipe_file = scan, recipe, recipe_file
        self._folder, self.unsaved = folder, False  # whether corrections are in use that were not saved
        self._saved_to: Path | None = None
        self.volume: Volume = read_volume(scan.volume, scan.series)
        self.axes = list_slice_axes(self.volume)
        self._search = VolumeSearch(self.volume)
        self._first: Examination | None = None
        self.found, self.corrections = Examination(scan), Corrections()
        self.refusal: NeedlefitError | None = None  # of the last examination
        self._tubes: tuple[TubeFinding, ...] = ()
        self.course: NeedleCourse | None = None

    def _take(self, found: Examination, corrections: Corrections) -> None:
        self.found, self.corrections, self.unsaved = found, corrections, corrections.any
        self.refusal = found.error
        self._tubes = list_tubes(self._search, self._correct_recipe(corrections), found.selection)
        self.course = None if found.needle_axis is None else make_course(found.needle_axis.points)

    def _correct_recipe(self, corrections: Corrections) -> ReconstructionRecord:
        if corrections.ball_mm is None:
            return self.recipe
        markers = self.recipe.markers.model_copy(update={"diameter_mm": corrections.ball_mm})
        return self.recipe.model_copy(update={"markers": markers})

    def again(self, content: object) -> None:
        """Examine the scan again, with the corrections that a page sent.

        DataError if a correction is no place, or balls are given to a scan without markers.
        """
        given = read_corrections(content)
        if not given.any:
            self._first = self._first or self._examine(self.scan, self.recipe)
            self._take(self._first, given)
            return
        with TemporaryDirectory(prefix="needlefit-") as name:
            found = self._examine(correct_scan(self.scan, given, Path(name)), self._correct_recipe(given))
        if found.error is not None and found.error.where.startswith(name):
            found = replace(found, error=found.error.at("balls placed by hand"))
        if _progress(found) >= _progress(self.found):
            self._take(found, given)
        else:
            self.refusal = found.error

    def _examine(self, scan: Scan, recipe: ReconstructionRecord) -> Examination:
        """Return what is found in a scan; what a dataset may not hold is refused, as when it is written."""
        found = examine(self.volume, scan, recipe, self._search)
        if found.reconstruction is None:
            return found
        with TemporaryDirectory(prefix="needlefit-") as folder:
            about = DatasetDescription(scan.id)
            _, refused = assemble_checked(Path(folder), [found.reconstruction], recipe, about)
        return replace(found, reconstruction=None, error=refused[0].error) if refused else found

    def save_shown(self, content: object) -> Path:
        """Save the corrections in use, as `save`, if they are those that a page shows.

        DataError if another window has changed them.
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
        folder, number = self._saved_to or self._folder, 1
        while True:
            try:
                folder.mkdir(parents=True, exist_ok=folder == self._saved_to)
                break
            except FileExistsError:
                number += 1
                folder = self._folder.with_name(f"{self._folder.name}-{number}")
        path = folder / TABLE_FILE
        write_scan_table([correct_scan(self.scan, self.corrections, folder)], path)
        shutil.copyfile(self._recipe_file, folder / RECIPE_FILE)
        if self.corrections.ball_mm is not None:
            tables = self._correct_recipe(self.corrections).model_dump(mode="json", by_alias=True)
            (folder / RECIPE_FILE).write_text(dumps(tables), encoding="utf-8")
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
        recipe, out = str(table.with_name(RECIPE_FILE).resolve()), f"{table.parent.name}_dataset"
        return shlex.join(
            ["needlefit", "reconstruct", str(table.resolve()), "--recipe", recipe, "--out", out]
        )

    def cut(self, request: Mapping[str, Any]) -> bytes:
        """Return a slice as PNG; DataError if there is no such slice."""
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
        recipe = self._correct_recipe(self.corrections)
        tissue, missed, balls, candidates, course = median_tissue_hu(volume), {}, [], [], None
        if found.registration is not None:
            lengths = np.linalg.norm(found.registration.residuals, axis=1)
            missed = dict(zip(found.registration.pairs[:, 0].tolist(), lengths.tolist(), strict=True))
        if (markers := found.markers) is not None:
            balls = [
                {"at": center.tolist(), "sd": float(sd), "residual": missed.get(n), "source": markers.source}
                for n, (center, sd) in enumerate(zip(markers.centers, markers.sd, strict=True))
            ]
            alike = sorted(markers.rejected, key=lambda one: one.misfit / one.max_misfit)[:MAX_CANDIDATES]
            candidates = [{"at": one.center.tolist(), "diameter": one.diameter} for one in alike]
        if self.course is not None:
            course = {name: np.round(line, 4).tolist() for name, line in vars(self.course).items()} | {
                "rows": len(self.course.aside), "pixel": PIXEL_MM, "half_width": HALF_WIDTH_MM,
            }  # fmt: skip
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
            "examined": self._first is not None,
            "error": _describe_error(found.error),
            "refusal": None if self.refusal is found.error else _describe_error(self.refusal),
            "warnings": list(found.reconstruction.warnings if found.reconstruction else volume.warnings),
            "tubes": [
                {name: getattr(tube, name) for name in ("length", "width", "chosen")}
                | {"line": tube.ends.tolist(), "middle": tube.ends.mean(axis=0).tolist()}
                for tube in self._tubes
            ],
            **_describe_needle(found),
            "balls": balls,
            "candidates": candidates,
            "ball_mm": recipe.markers.diameter_mm,
            **_describe_reconstruction(found),
            "course": course,
            "corrections": self.corrections.to_json(),
            "has_markers": self.scan.markers is not None,
            "min_balls": MIN_MARKERS,
            "min_points": MIN_POINTS,
            "entry_stated": self.scan.stage is not None,
        }


def _describe_error(error: NeedlefitError | None) -> dict[str, str] | None:
    if error is None:
        return None
    return {key: getattr(error, key) for key in ("what", "where", "expected", "fix")}


def _progress(found: Examination) -> tuple[bool, int]:
    """Return whether a scan was reconstructed, and how many steps found something."""
    steps = (found.selection, found.needle_axis, found.markers, found.registration)
    return found.reconstruction is not None, sum(step is not None for step in steps)


def _describe_needle(found: Examination) -> dict[str, Any]:
    """Return the needle's axis, where the tissue may begin, and the tip."""
    axis = found.needle_axis
    if axis is None:
        return {"entries": [], "axis": None, "tip": None}
    entries = list_entries(axis, found.profile)
    places = zip(entries, place_entries(axis.points, entries), strict=True)
    tip = {"at": axis.tip.tolist(), "along_sd": float(axis.tip_sd[0])}
    kept = np.unique(np.linspace(0, len(axis.points) - 1, SHOWN_POINTS).round().astype(np.int64))
    return {
        "entries": [
            {"depth": one.depth, "sd": one.sd, "change": one.change, "at": at.tolist()} for one, at in places
        ],
        "axis": axis.points[kept].tolist(),
        "tip": tip | {"placed": found.scan.tip is not None},
    }


def _describe_reconstruction(found: Examination) -> dict[str, Any]:
    """Return entry, layers, interfaces that the scan shows where they were asked for, and the depth."""
    one = found.reconstruction
    if one is None:
        return {"contact": None, "layers": [], "proposed": [], "inserted": None}
    at = one.patient.to_local(one.points[:1])[0].tolist()
    contact = {"at": at, "along_sd": one.pose.along_sd, "source": one.pose.source}
    places = one.patient.to_local(one.layers.points.reshape(-1, 3)).tolist()
    crossed = zip(one.layers.boundaries, one.layers.sd, places, strict=True)
    proposed = []
    for interface in one.proposals or ():
        world = interpolate_at_arc(one.points, np.array([interface.at]))
        row = {"depth": float(one.frame.to_local(world)[0, 0]), "sd": interface.sd, "step": interface.step}
        proposed.append(row | {"at": one.patient.to_local(world)[0].tolist()})
    length = float(arc_length(one.needle_axis.points)[-1])
    return {
        "contact": contact | {"placed": found.scan.contact is not None},
        "layers": [{"depth": float(depth), "sd": float(sd), "at": at} for depth, sd, at in crossed],
        "proposed": proposed,
        "inserted": {"depth": one.depth, "sd": one.depth_sd, "length": length},
    }
