"""Stack slices into a volume, after checks of all headers and before any voxel is read.

Metal, tissue and air are distinguished by their attenuation, air by its -1000 HU. Hence only images made with
X-rays are taken (cone-beam scanners and C-arms say CT, some XA), and only with a rescaling: what is stored is
no HU, often these plus 1024, and an offset that is guessed would move the face of the tissue. A stated tilt
of the gantry is only remarked on where the slices stand straight above each other: a series that was
straightened keeps the entry, and the standard says that nothing is to be computed from it.
"""

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from pydicom.uid import UID

from needlefit.arrays import Floats
from needlefit.errors import DataError
from needlefit.imaging.dicom.header import LOCALIZER, DicomSlice
from needlefit.imaging.header_checks import ImageHeader, check_expansion
from needlefit.imaging.volume import AXES_COSINE_TOLERANCE, VoxelGrid, check_grid, orthogonalize

MAX_OFFSET_MM = 0.05
"""A slice may stand this far from its place on an even stack, mm: positions rounded to 0.1 mm do."""

MIN_STEP_MM = 1e-3
"""Slices closer than this are one, mm."""

MAX_STEP_RATIO = 1.5
"""A step longer than this many usual ones lacks slices."""

XRAY_MODALITIES = frozenset({"", "CT", "XA", "RF", "DX", "PX", "IO", "OT"})
"""Modalities whose values are attenuations; converters leave the entry out, or write OT (other)."""

OTHER_MODALITIES = {
    "MR": "magnetic resonance, in which a needle is a void without a sharp edge",
    "US": "ultrasound",
    "PT": "positron emission tomography",
    "NM": "nuclear medicine",
    "MG": "mammography",
    "OCT": "optical coherence tomography",
    "OPT": "optical coherence tomography",
}

HU_UNITS = ("", "HU", "HU_MOD", "US")
"""What RescaleType says of values in HU; US is "unspecified", as cone-beam scanners write."""

HU_FIX = (
    "export it in HU; a micro-CT scanner needs scans of air (-1000) and water (0) for that. Or compute HU "
    "yourself, linearly from both, and save the volume as NRRD"
)

MIN_TILT_DEG = 0.05
"""A stated angle of the gantry below this, degrees, is none."""

DECODED_SYNTAXES = frozenset(
    f"1.2.840.10008.1.2{end}"
    for end in ("", ".1", ".1.99", ".2", ".5", ".4.50", ".4.51", ".4.57", ".4.70", ".4.80", ".4.81")
) | {"1.2.840.10008.1.2.4.90", "1.2.840.10008.1.2.4.91"}
"""Transfer syntaxes that SimpleITK unpacks: none, deflated, RLE, JPEG, JPEG-LS, JPEG 2000."""

EXPECTED_STACK = "every slice straight above the one before"

_EXPORT_FIX = "export the series from the scanner or the archive again, as original axial slices"


def stack_slices(slices: Sequence[DicomSlice]) -> tuple[list[DicomSlice], VoxelGrid]:
    """Return the slices in the order of their positions, and the grid of their voxels.

    The order is along the normal of the slices (row cross column direction), so that the axes of the
    grid are right-handed; file names and instance numbers do not matter.

    Raises
    ------
    DataError
        If the slices are not one even, straight, complete stack of plain images.
    """
    _check_kinds(slices)
    _check_alike(slices)
    first = slices[0]
    axes, positions = _measure_axes(first), np.array([item.position for item in slices])  # (2, 3), (K, 3)
    normal = np.cross(axes[0], axes[1])
    order = np.argsort(positions @ normal, kind="stable")
    ordered, positions = [slices[index] for index in order], positions[order]
    spacing = _measure_slice_spacing(ordered, positions, normal)
    assert first.pixel is not None
    grid = VoxelGrid(
        size=(first.columns, first.rows, len(ordered)),
        origin=positions[0],
        # PixelSpacing is row spacing (y), then column spacing (x); the grid is x, y, z
        spacing=np.array([first.pixel[1], first.pixel[0], spacing]),
        direction=np.column_stack([axes[0], axes[1], normal]),
    )
    check_grid(grid, str(first.file.parent))
    _check_lengths(ordered)
    return ordered, grid


def describe_tilt(slices: Sequence[DicomSlice]) -> tuple[str, ...]:
    """Return a warning about a straight stack whose headers state a gantry tilt."""
    tilt = max((item.tilt for item in slices), key=abs)
    if abs(tilt) < MIN_TILT_DEG:
        return ()
    return (
        f"the scan's headers state a gantry tilted by {abs(tilt):g} degrees (GantryDetectorTilt), but "
        "its slices stand straight: right if it was straightened after the scan, else all in it is sheared",
    )


def describe_units(slices: Sequence[DicomSlice]) -> tuple[str, ...]:
    """Return a warning about values of which the headers do not say that they are HU."""
    if not any(item.unit == "US" for item in slices):
        return ()
    return (
        "the scan's headers call the unit of its values unspecified (RescaleType US): thresholds and the "
        "edge of the tissue are right only if air is -1000 and water 0",
    )


def _measure_axes(item: DicomSlice) -> Floats:
    """Return the row and column directions (2, 3) of a slice, made perpendicular to the last digit."""
    assert item.axes is not None
    if not (np.abs(item.axes @ item.axes.T - np.eye(2)) <= AXES_COSINE_TOLERANCE).all():
        raise DataError(
            f"ImageOrientationPatient is {item.axes.round(4).tolist()}",
            where=item.where,
            expected="two perpendicular unit vectors",
            fix=_EXPORT_FIX,
        )
    return orthogonalize(np.vstack([item.axes, np.cross(*item.axes)]).T).T[:2]


def _check_kinds(slices: Sequence[DicomSlice]) -> None:
    """See that every file is a plain image with a place in the patient."""
    faults = [(item, fault) for item in slices if (fault := _kind_fault(item)) is not None]
    if not faults:
        return
    (item, (what, expected, fix)), others = faults[0], len(faults) - 1
    more = f" ({others} more of {len(slices)} files have a fault of this sort)" if others else ""
    raise DataError(what + more, where=item.where, expected=expected, fix=fix)


def _kind_fault(item: DicomSlice) -> tuple[str, str, str] | None:
    """Return what forbids one file in any stack: what, expected, fix."""
    if item.frames > 1:
        fix = "convert it to NRRD, e.g. with 3D Slicer, or export it as single-frame (classic) or enhanced CT"
        return f"holds {item.frames} frames without their positions", "one slice a file, or enhanced CT", fix
    if LOCALIZER in item.kind:
        fix = "move localizers (scouts, topograms) to a folder of their own"
        return "is a localizer among the slices of a volume", "slices of the volume only", fix
    places = ("ImagePositionPatient", item.position), ("ImageOrientationPatient", item.axes)
    if item.modality not in XRAY_MODALITIES:
        meaning = OTHER_MODALITIES.get(item.modality, "")
        fix = "give the CT; if this is one and its header is wrong, save it as NRRD, e.g. with 3D Slicer"
        what = f"is no CT: its Modality is {item.modality}" + f", {meaning}" * bool(meaning)
        return what, "attenuation of X-rays, in HU: its thresholds separate needle, tissue and air", fix
    missing = [name for name, value in (*places, ("PixelSpacing", item.pixel)) if value is None]
    if missing:
        return f"has no {', '.join(missing)}", "where the slice stands in the patient", _EXPORT_FIX
    if item.samples != 1 or item.table:
        what = "rescales its values by a table" if item.table else f"holds {item.samples} colours a voxel"
        return what, "one attenuation a voxel, with a slope and an intercept", _EXPORT_FIX
    if item.rescale is None:
        return "has no RescaleSlope, RescaleIntercept: its values are no HU", "how values become HU", HU_FIX
    if item.unit not in HU_UNITS:
        return f"RescaleType is {item.unit}: its values are no HU", "a series in HU", HU_FIX
    if item.rescale[0] == 0.0:
        return "RescaleSlope is 0", "a slope that keeps the values apart", _EXPORT_FIX
    if item.syntax not in DECODED_SYNTAXES:
        name = UID(item.syntax).name
        fix = "decompress the series, e.g. `gdcmconv --raw IN OUT` for every file, or export it uncompressed"
        return f"is compressed as {name}, for which there is no decoder", "plain, RLE, JPEG, JPEG 2000", fix
    return None


def _check_alike(slices: Sequence[DicomSlice]) -> None:
    """See that all slices have the size, spacing, orientation and kind of values of the first."""
    first = slices[0]
    for item in slices[1:]:
        difference = _find_difference(first, item)
        if difference:
            raise DataError(
                f"its {difference[0]} is {difference[2]}, that of {first.name} is {difference[1]}",
                where=item.where,
                expected="the same in every slice of a series",
                fix="move the slices of another scan to a folder of their own, or export the series again",
            )


def _find_difference(one: DicomSlice, other: DicomSlice) -> tuple[str, object, object] | None:
    """Return in what two slices differ, and both values; None if in nothing that matters."""
    assert (
        one.pixel is not None and one.axes is not None and other.pixel is not None and other.axes is not None
    )
    pixels = max(one.rows, one.columns)
    extent = pixels * float(one.pixel.max())
    unlike = (
        ("size", (one.rows, one.columns), (other.rows, other.columns)),
        ("frame of reference", one.frame_of_reference, other.frame_of_reference),
    )
    for name, a, b in unlike:
        if a != b:
            return name, a, b
    if np.abs(one.pixel - other.pixel).max() * pixels > MAX_OFFSET_MM:
        return "pixel spacing", one.pixel.tolist(), other.pixel.tolist()
    if np.abs(one.axes - other.axes).max() * extent > MAX_OFFSET_MM:
        return "orientation", one.axes.round(4).tolist(), other.axes.round(4).tolist()
    return None


def _measure_slice_spacing(ordered: Sequence[DicomSlice], positions: Floats, normal: Floats) -> float:
    """Return the spacing of slices, mm, whose `positions` (K, 3) stand in their order along `normal`."""
    folder = str(ordered[0].file.parent)
    if len(ordered) < 2:
        raise DataError(
            "holds one slice",
            where=folder,
            expected="a stack of slices",
            fix="copy all files of the series into the folder",
        )
    along = (positions - positions[0]) @ normal  # (K,)
    _check_steps(ordered, np.diff(along))
    _check_straight(ordered, along, positions - positions[0] - along[:, None] * normal)
    # the mean step: rounding of single positions must not add up over the stack
    spacing = float(along[-1]) / (len(ordered) - 1)
    astray = np.abs(along - spacing * np.arange(len(ordered)))
    if astray.max() > MAX_OFFSET_MM:
        worst = int(astray.argmax())
        raise DataError(
            f"stands {astray[worst]:.3g} mm from its place in an even stack of {spacing:.4g} mm steps",
            where=ordered[worst].where,
            expected=f"even steps, to {MAX_OFFSET_MM} mm",
            fix="resample the series to even steps, e.g. in 3D Slicer, and save it as NRRD",
        )
    return spacing


def _check_steps(ordered: Sequence[DicomSlice], steps: Floats) -> None:
    """See that no slice is there twice and none is missing; `steps` (K - 1,), mm."""
    usual = float(np.median(steps))
    for (before, after), step in zip(pairwise(ordered), steps, strict=True):
        if step < MIN_STEP_MM:
            raise DataError(
                f"stands at the same place as {before.name}",
                where=after.where,
                expected="every slice once",
                fix="remove the copies; if the series holds several phases or times, export one of them",
            )
        if usual >= MIN_STEP_MM and step > MAX_STEP_RATIO * usual:
            raise DataError(
                f"{round(step / usual) - 1 or 1} slice(s) missing between {before.name} "
                f"and {after.name}: a step of {step:.4g} mm where others are {usual:.4g} mm",
                where=str(before.file.parent),
                expected="a stack without gaps",
                fix="copy the missing files; a series with two spacings must be resampled to one",
            )


def _check_straight(ordered: Sequence[DicomSlice], along: Floats, across: Floats) -> None:
    """See that the stack does not lean; `across` (K, 3) is how far slices shift in their own plane, mm."""
    if np.linalg.norm(across, axis=1).max() <= MAX_OFFSET_MM:
        return
    lean = np.outer(along / along[-1], across[-1])
    angle = np.degrees(np.arctan2(np.linalg.norm(across[-1]), along[-1]))
    if np.linalg.norm(across - lean, axis=1).max() > MAX_OFFSET_MM:
        raise _shifted_slices_error(ordered, across)
    raise DataError(
        f"the stack leans by {angle:.3g} degrees: the gantry was tilted",
        where=str(ordered[0].file.parent),
        expected=EXPECTED_STACK,
        fix="resample the series onto a straight grid, e.g. with the gantry-tilt correction of dcm2niix or "
        "3D Slicer, and save it as NRRD",
    )


def _shifted_slices_error(ordered: Sequence[DicomSlice], across: Floats) -> DataError:
    """Return the error for slices that stand beside the others; `across` (K, 3), mm."""
    beside = np.linalg.norm(across - np.median(across, axis=0), axis=1)
    worst, count = int(beside.argmax()), int((beside > MAX_OFFSET_MM).sum())
    more = f", as {count - 1} more of {len(ordered)} slices do to some extent" if count > 1 else ""
    return DataError(
        f"stands {beside[worst]:.3g} mm beside most of the other slices{more}",
        where=ordered[worst].where,
        expected=EXPECTED_STACK,
        fix=_EXPORT_FIX,
    )


def _check_lengths(slices: Sequence[DicomSlice]) -> None:
    """See that every unpacked file is long enough for the voxels that it claims."""
    frames = Counter(item.file for item in slices)
    for item in slices:
        needed = frames[item.file] * item.rows * item.columns * item.bits // 8
        size = item.file.stat().st_size
        plain = not item.syntax.is_compressed and not item.syntax.is_deflated
        if plain and size < needed:
            raise DataError(
                f"claims {item.columns} x {item.rows} voxels, {needed} bytes, and has {size} bytes",
                where=item.where,
                expected="all its voxels",
                fix="the file is cut short or damaged: copy it again, or export the series again",
            )
    first, packed = slices[0], sum(file.stat().st_size for file in frames)
    voxel_bytes = max(item.bits for item in slices) // 8
    promised = ImageHeader((first.columns, first.rows, len(slices)), voxel_bytes, packed)
    check_expansion(promised, first.file.parent)
