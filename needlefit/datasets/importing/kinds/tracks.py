"""Tip tracks: a row for each reading of a tip on its way, with its depth or place, and that of the guide."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.datasets.importing.draft_table import MAX_FLAGS, Columns, Records, TableDraft, name_points
from needlefit.datasets.importing.kinds import (
    BendsOfSides,
    CurveAnswers,
    ImportedCurve,
    Placer,
    RowKind,
    StatedValues,
    format_direction,
    list_names,
    snap_to_axis,
)
from needlefit.datasets.importing.mapped_table import MappedTable
from needlefit.datasets.importing.meanings import find_meaning, read_header
from needlefit.datasets.importing.stated import Stated, name_set
from needlefit.datasets.insertion import GUIDE_STILL_MM
from needlefit.datasets.layers import SAME_POINT_MM
from needlefit.errors import DataError
from needlefit.geometry.common_direction import fit_direction
from needlefit.geometry.frames import normalize, to_unit

# Tracks of one session are usually of one specimen; a new one would be predicted less well.
TRACK_SPECIMEN = ("specimen1", "all runs into one; specimen=each if every run had a specimen of its own")
MARGIN_FOR = "the error of a reading"  # words for what the margin of a study is
PLACING_PART = 1 / 3  # fraction of the shallowest run whose readings register a run in the tracker's frame
MIN_GUIDE_PART = 0.5  # smallest fraction of a guide's motion that is used, where some axes are not stated
MIN_BEVEL_DEG = 60.0  # smallest angle (degrees) from the insertion to the direction that bevels face
#: largest step back of a tip, in its SD, that is noise: 5 SD of the difference of two readings
MAX_BACKWARD_SDS = 5 * np.sqrt(2)
DEPTH_DECIMALS = 4  # decimals of depths (mm) in tracks.csv: depths that are written alike are of one place
MIN_TRACK_SLOPE = 0.7  # smallest movement (mm per mm of depth) of a tip whose coordinates are all in space


class TrackPlacer(Placer):
    """Places runs in the frame of their tracker: points become deflections along y and z at their depths."""

    def settle_places(self) -> None:
        """Settle guide, depths and bevels."""
        settle_guide(self)
        curves = self.curves
        for curve in curves:
            curve.depths = curve.reading_depths
        settle_depth_zero(self)
        if self.is_stated("entry_point") and any(len(curve.depths) for curve in curves):
            self.note("entry_point", "not used of runs whose depths are stated")
        if not all(len(curve.depths) for curve in curves):
            measure_depths(self)
        settle_rolls(self)
        self.note_deflections("shift and slope of each run are fitted")
        bevel = self.settle_bevel()
        across = np.cross(np.sum([curve.chord for curve in curves], axis=0), bevel)
        planes = np.column_stack([bevel, to_unit(across), np.zeros(3)])  # of deflections 0
        for curve in curves:
            curve.points = replace(curve.points, values=curve.line @ planes)
            if curve.guide is not None:
                curve.guide = project_guide(curve, curve.guide, planes)
        usual, reason = None, ""
        if any(map(is_guided, curves)):
            usual, reason = "free", "the guide moved, and its distance is not stated"
        self.usual = {"specimen": TRACK_SPECIMEN, "guide_distance": (usual, reason)}

    @property
    def is_posed(self) -> bool:
        """Whether the direction of insertion is stated in the frame of the tracker."""
        return not self.others and self.stated("pose") not in ("", "free", "shaft")

    def settle_bevel(self) -> Floats:
        """Return the direction that bevels of side 1 face, across the insertion.

        Beside other needles `bevel` is theirs, in whose frame no tracker reads.
        """
        curves, is_alone = self.curves, not self.others
        bevel = np.array([0.0, 1.0, 0.0])
        if all(curve.is_deflection for curve in curves):
            return bevel
        bends = find_bends(curves)
        guess, reason, fix = "bend", "the mean direction in which the tips bend from their sides", ""
        if not bends.agree:
            guess, reason = "", "tips bend to several sides, which a column `bevel side` should state"
            fix = f"name a table `run,bevel side`, too; if it states them: {name_set('bevel', 'X,Y,Z')}"
        if guess and not is_alone:
            self.note("bevel of tracks", reason)
        else:
            guess = self.settle("bevel", guess, reason, fix).text
        bevel = bends.mean if guess == "bend" else normalize(self.settle("bevel").to_vector())
        along = normalize(self.settle("pose").to_vector()) if self.is_posed else bends.direction
        if not self.is_posed:
            self.assumed["direction"] = f"{format_direction(along)}: the direction that fits all runs"
        sideways = bevel - (bevel @ along) * along
        if np.linalg.norm(sideways) < np.sin(np.radians(MIN_BEVEL_DEG)):
            needed = f"at least {MIN_BEVEL_DEG:g} degrees off the insertion, {format_direction(along)}"
            raise self.settle("bevel").error(needed)
        return normalize(sideways)

    def choose_study(self) -> Mapping[str, float | str]:
        """Return which readings place a predicted run, and which difference of errors does not matter.

        Errors of other kinds beside them are compared in noise.
        """
        ends = [curve.depths[[0, -1]] for curve in self.curves]
        usual = f"{min(float(first + PLACING_PART * (last - first)) for first, last in ends):.3g}"
        reason = "a third of the shallowest run; deeper ones are scored"
        depth = self.settle("registration_depth", usual, reason)
        number = depth.to_number(is_above=True)
        slope_sd = max(self.numbers("pose_angle_sd", is_above=True).values())
        self.slope_sds_deg = slope_sd, slope_sd if self.is_posed else None
        study: dict[str, float | str] = {"registration_depth_mm": number}
        return study if self.others else study | {"margin_mm": self.point_sd_mm, "margin_for": MARGIN_FOR}


def find_bends(curves: Sequence[ImportedCurve]) -> BendsOfSides:
    """Return how far runs bend from the direction that fits all of them, else from those of their entries.

    Readings until the first turn count: behind it a run bends to another side.
    """
    counts = {curve: int(np.cumprod(curve.rolls == curve.rolls[0]).sum()) for curve in curves}
    fitted = fit_direction([curve.line[:count] for curve, count in counts.items()])
    degree = 2 if fitted is None else 1  # of a parabola, or a line
    runs = [curve for curve, count in counts.items() if count > degree]
    bends, along = np.zeros((len(runs), 3)), np.zeros((len(runs), 3))
    for n, curve in enumerate(runs):
        depths, line = curve.depths[: counts[curve]], curve.line[: counts[curve]]
        *_, slope, _ = terms = np.polyfit(depths - depths[0], line, degree)
        bends[n] = np.ptp(depths) ** degree * terms[0]
        if fitted is not None:
            along[n] = fitted.vector
        elif np.linalg.norm(slope) > MIN_TRACK_SLOPE:  # else the coordinates are across the needle
            along[n] = snap_to_axis(normalize(slope))
    return BendsOfSides(runs, bends, along)


def project_guide(curve: ImportedCurve, guide: Floats, planes: Floats) -> Floats:
    """Return the places of a guide (N, 3) along the directions of deflections, from the first one on, mm.

    DataError if some of its axes are not stated, and most of its motion along the others is lost.
    """
    moved = np.nan_to_num(guide - guide[0])
    across = moved @ planes
    size, kept = (float(np.linalg.norm(np.ptp(places, axis=0))) for places in (moved, across))
    if np.isnan(guide).any() and size >= GUIDE_STILL_MM and kept < MIN_GUIDE_PART * size:
        axes, bevel = "".join(np.array([*"xyz"])[~np.isnan(guide[0])]), "xyz"[np.argmax(np.abs(planes[:, 0]))]
        raise DataError(
            f"the guide of {curve.name} moves {size:.3g} mm along {axes}; {kept:.2g} mm of it are across the "
            "needle, in the plane of its bevel",
            expected="columns of the guide along x, y and z, or the axis along which its one column is",
            fix=(
                f"if its one column is along {bevel}: {name_set('guide.axes', bevel)}; if it is no guide: "
                f"{name_set('guide', 'none')}"
            ),
            where=curve.points.where(),
        )
    return across


def settle_rolls(asked: CurveAnswers) -> None:
    """Settle sides and turns of the bevels: `rolls` become rad, about side 1 of the plane they bend in.

    A turn at a stated depth is that of the next reading. DataError if bevels begin other ways than up and
    down, and nothing states where up is.
    """
    curves = asked.curves
    for curve in curves:
        if len(curve.rolls):
            curve.stated["bevel_side"] = Stated(
                "bevel_side", f"{curve.rolls[0]:.6g} deg", "", curve.points.where()
            )
    contact = asked.settle_sides(is_needed=True)
    if measured := [curve for curve in curves if curve.sensors]:
        raise DataError(
            f"run {measured[0].name} has curvatures beside its readings",
            expected="readings alone",
            fix=f"leave it out: {name_set('leave_out', ','.join(curve.name for curve in measured))}",
            where=measured[0].points.where(),
        )
    in_space = not all(curve.is_deflection for curve in curves) and asked.stated("bevel") in ("", "bend")
    if in_space and len({curve.turn for curve in curves}) > 1:
        raise DataError(
            "bevels face several ways, and nothing states where up is in the frame of the tips",
            expected="sides 1 and -1; or the direction of 0 degrees (12 o'clock)",
            fix=f"state {name_set('bevel', 'X,Y,Z')}",
            where=curves[0].points.where(),
        )
    is_flat = any(curve.turn for curve in curves) and not any(curve.line[:, 2].any() for curve in curves)
    if is_flat and not in_space:
        asked.assumed["deflection"] = "toward the bevel of side 1: one deflection is stated of each tip"
    for curve in curves:
        if in_space or is_flat:  # of one plane, in which they bend
            curve.turn = 0.0
        starts = np.append(0.0, curve.depths[:-1])
        rolls = curve.rolls if len(curve.rolls) else np.full(len(starts), contact[curve])
        for depth, cell in curve.turns:
            rolls[np.searchsorted(starts, depth - SAME_POINT_MM) :] = cell.to_angle()
        curve.rolls = curve.turn + np.radians((rolls - contact[curve]) % 360.0)


def settle_guide(asked: CurveAnswers) -> None:
    """Take another tool that was tracked beside each tip as the guide, if its name is stated.

    DataError if no tool has that name, or not one was tracked beside each tip.
    """
    curves, stated = asked.curves, asked.stated("guide")
    if stated == "none":
        for curve in curves:
            curve.guide = None
    if stated in ("", "none") or any(curve.guide is not None for curve in curves):
        return
    answer, names = asked.settle("guide"), list_names(curves)
    guides = [curve for curve in curves if f"-{curve.given}".endswith(f"-{answer.text}")]
    curves[:] = [curve for curve in curves if curve not in guides]
    for guide in guides:
        of_file = [tip for tip in curves if tip.points.path == guide.points.path]
        paired = [tip for tip in of_file if len(tip.line) == len(guide.line)]
        if len(paired) == 1:
            paired[0].guide = guide.line
    if not 0 < len(guides) == sum(tip.guide is not None for tip in curves):
        raise answer.error(f"none, or one of {names}, tracked beside one tip at the same times")


def settle_depth_zero(asked: CurveAnswers) -> None:
    """Count the stated depths of readings from the surface of the tissue; those before contact are left out.

    DataError if depths that count from there, as stated, begin before it.
    """
    curves = [curve for curve in asked.curves if len(curve.depths)]
    is_open = any(curve.depths[0] for curve in curves) or asked.is_stated("depth_zero")
    if not (curves and is_open):
        return
    first = min(curves, key=lambda curve: curve.depths[0])
    other = next((curve for curve in curves if read_header(curve.depth_column).meaning != "depth"), None)
    usual, reason = "tissue", f"column {first.depth_column} is called a depth"
    if other is not None:
        usual, reason = "first_reading", f"column {other.depth_column} is not called a depth"
    if first.depths[0] < 0:
        usual, reason = "first_reading", f"{first.name} begins at {first.depths[0]:g} mm"
    for curve, answer in asked.each("depth_zero", usual, reason).items():
        if len(curve.depths):
            count_depths(asked, curve, answer)


def count_depths(asked: CurveAnswers, curve: ImportedCurve, depth_zero: Stated) -> None:
    """Count the depths of readings from where it is stated that they begin; leave out those before."""
    if depth_zero.text == "tissue" and curve.depths[0] < 0:
        raise depth_zero.error(f"first_reading: {curve.name} begins at {curve.depths[0]:g} mm")
    zeros = {"tissue": 0.0, "first_reading": float(curve.depths[0])}
    zero = zeros[depth_zero.text] if depth_zero.text in zeros else depth_zero.to_number()
    if zero > curve.depths[-1]:
        raise depth_zero.error(f"at most the depth of its readings, {curve.depths[-1]:g} mm")
    keep_readings(asked, curve, curve.depths - zero, curve.depths >= zero, "before contact")


def measure_depths(asked: CurveAnswers) -> None:
    """Take the path of each tip along the stage axis as its depth, from the first reading or the entry on."""
    chord = np.sum([curve.chord for curve in asked.curves], axis=0)
    guess = format_direction(snap_to_axis(normalize(chord)))
    pose = asked.settle("pose", guess, "the direction in which the tips run")
    axis, entries = normalize(pose.to_vector()), StatedValues()
    moved = {curve: np.ptp(curve.line @ axis) for curve in asked.curves if not len(curve.depths)}
    if still := ",".join(curve.name for curve, run in moved.items() if run < GUIDE_STILL_MM):
        raise DataError(
            f"{still} moves less than {GUIDE_STILL_MM:g} mm along {pose.text}",
            expected="tips on their way into the tissue",
            fix=f"leave it out: {name_set('leave_out', still)}; or correct {name_set('pose', 'X,Y,Z')}",
            where=asked.curves[0].points.where(),
        )
    if asked.is_stated("entry_point"):
        entries = asked.each("entry_point")
    zeros = asked.each("depth_zero") if asked.is_stated("depth_zero") else StatedValues()
    for curve, sd in asked.numbers("point_sd", is_above=True).items():
        if curve not in moved:
            continue  # its file states them
        start = entries[curve].to_vector() if entries else curve.line[0]
        depths = ((curve.line - start) @ axis).round(DEPTH_DECIMALS)
        deepest, is_kept, why = np.maximum.accumulate(depths), depths >= 0, "before the entry"
        if np.any(np.diff(depths) <= 0) and np.all(deepest - depths <= MAX_BACKWARD_SDS * sd):
            is_kept &= np.diff(deepest, prepend=-np.inf) > 0
            why = "by noise less deep than one before"
        keep_readings(asked, curve, depths, is_kept, why)
        if zeros:
            count_depths(asked, curve, zeros[curve])
    origin = "the entry point" if entries else "the first reading"
    less = ", less what depth_zero states" if zeros else ""
    asked.assumed["depth"] = f"the path of the tip along {pose.text} from {origin} on{less}"


def keep_readings(
    asked: CurveAnswers, curve: ImportedCurve, depths: Floats, is_kept: NDArray[np.bool_], why: str
) -> None:
    """Leave out the other readings, and say why; `depths`: of all, mm."""
    if not is_kept.all():
        count = f"{np.sum(~is_kept)} of {len(depths)} readings"
        asked.note(curve.name, f"{count} are left out: {why}")
    rows = np.flatnonzero(is_kept)
    curve.depths = depths[rows]
    curve.keep_readings(rows)


def is_guided(curve: ImportedCurve) -> bool:
    """Return whether the guide moved across the needle during a run."""
    return curve.guide is not None and bool(np.ptp(curve.guide[:, :2], axis=0).max() >= GUIDE_STILL_MM)


# smallest number of signs of a track, of three: depths that differ, times that differ, a column of a tip
MIN_SIGNS = 2


def propose_tracks(draft: TableDraft, is_stated: bool) -> dict[str, Columns]:
    """Return the columns of readings: deflections at increasing depths, or places with signs of a track."""
    points = draft.points
    words = {find_meaning("column", word) for name in points for word in name.split()}
    is_log = (is_stated or "tool" in words or "time" in draft.changing) and not draft.are_deflections
    if 1 < len(points) <= MAX_FLAGS and is_log and "guide" not in draft.draft.values:
        alone = name_points(points.values())
        guides = ({"guide.column": "|".join(keys.values())} for keys in reversed(alone.values()))
        draft.ask_tools(alone, {tip: alone[tip] | guide for tip, guide in zip(alone, guides, strict=True)})
    if is_stated or not points:
        return points
    if draft.are_deflections:
        is_track, reason = draft.increases(draft.taken["depth"][0]), "the depths of each needle increase"
    else:
        is_tip = "tip" in words or any(
            column.beside in ("tip", "deflection") for column in draft.axis_columns
        )
        is_alone = "tip" in words or (len(draft.groups) < 2 and not draft.names_rows)
        is_track = is_alone and is_tip + len(draft.changing) >= MIN_SIGNS
        reason = f"each row has a {min(draft.changing, default='')} of its own"
    if is_track:
        draft.draft.assumed["holds"] = f"tracks: {reason}; points: {name_set('holds', 'shapes')}"
    return points if is_track else {}


def complete_tracks(draft: TableDraft, records: Records) -> None:
    """Ask along which axis a guide is, where nothing states it."""
    guide = records.get("guide")
    is_open = guide is not None and "axes" not in guide and draft.draft.values.get("guide") != "none"
    if guide is not None and is_open and "deflection" not in records:
        draft.ask("guide", name=guide["column"])


def read_readings(mapped: MappedTable, curve: ImportedCurve, rows: Sequence[int]) -> None:
    """Add the depths of readings, and where the bevel faced, where columns state them of each."""
    if "bevel_side" in mapped.record.columns and "bevel_side" not in curve.stated:
        curve.rolls = np.array([mapped.read_side(n).to_angle() for n in rows])
    if (record := mapped.record.columns.get("depth")) is not None:
        curve.stated.pop("depth", None)
        curve.depths = mapped.read_numbers("depth", rows)
        curve.depth_column = str(record.columns[0])


TRACKS = RowKind(
    "tracks",
    propose_tracks,
    6,
    varying=("depth", "point_sd", "bevel_side"),
    has_points=True,
    is_track=True,
    placer=TrackPlacer,
    complete=complete_tracks,
    read=read_readings,
)
