"""Read NIfTI files by nibabel, and turn their coordinates from RAS to LPS.

SimpleITK would make up where a scan stands that does not say it, take missing voxels and those without a
value for 0, and refuse the slices of a tilted gantry.
"""

import gzip
import math
import zlib
from itertools import product
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
from nibabel.arrayproxy import ArrayProxy
from nibabel.filebasedimages import ImageFileError
from nibabel.spatialimages import HeaderDataError

from needlefit.arrays import Floats
from needlefit.errors import located, refusal
from needlefit.geometry.frames import RAS_TO_LPS
from needlefit.imaging.volume import (
    AXES_COSINE_TOLERANCE,
    VoxelGrid,
    check_expansion,
    check_grid,
    fill_unknown,
    grid_to_json,
    missing_voxels,
    not_one_volume,
    orthogonalize,
    unreadable_header,
)
from needlefit.project.reader_process import Arrays, allow_memory

_MILLIMETRES = {"meter": 1e3, "mm": 1.0, "micron": 1e-3}  # one unit of a header in mm
NO_UNIT = (
    "the header states no unit of length (`xyzt_units`), and mm are taken: compare a known length, and state "
    "the unit where the file is made"
)


def read_nifti(arrays: Arrays, path: str, stored: int, labels: bool = False) -> dict[str, Any]:
    """Read a NIfTI file: add the array "values"; return its grid, and warnings.

    `stored`: bytes of the file.
    `labels`: whether the file holds labels.

    DataError if the file is none, is cut short, has not three dimensions, does not say where the patient's
    left is, or says it twice and differently, or claims an absurd size.
    """
    file, notes = Path(path), list[str]()
    with located(path):
        try:
            image = nibabel.load(file)
            assert isinstance(image, nibabel.Nifti1Image)  # NIfTI-2 is one, too
            assert isinstance(image.dataobj, ArrayProxy)
            header, proxy = image.header, image.dataobj
            stated = header.get_xyzt_units()[0]
            unit = _MILLIMETRES.get(stated, 1.0)
            if stated not in _MILLIMETRES:
                notes.append(NO_UNIT)
            scale = np.array([[unit], [unit], [unit], [1.0]])
            qform, sform = scale * header.get_qform(), scale * header.get_sform()
            steps = unit * np.abs(np.array(header["pixdim"][1:4], dtype=np.float64))
        except (ImageFileError, HeaderDataError, ValueError, AssertionError) as error:
            raise unreadable_header(str(error)[:200]) from error
        shape = list(image.shape)
        while len(shape) > 3 and shape[-1] == 1:
            shape.pop()
        if len(shape) != 3 or proxy.dtype.kind not in "iuf":
            parts = "numbers" if proxy.dtype.kind in "iuf" else "numbers of several parts"
            raise not_one_volume(f"{' x '.join(map(str, shape))} {parts}")
        columns, rows, slices = shape
        codes = int(header["qform_code"]), int(header["sform_code"])
        with np.errstate(invalid="ignore", divide="ignore"):  # what this leaves `check_grid` refuses
            affine = RAS_TO_LPS.rotation @ _choose_form(qform, sform, codes, steps, shape, notes)[:3]
            spacing = np.linalg.norm(affine[:, :3], axis=0)
            direction = affine[:, :3] / spacing
        grid = VoxelGrid((columns, rows, slices), affine[:, 3], spacing, direction)
        check_grid(grid)
        count = math.prod(grid.size)
        content, memory = count * proxy.dtype.itemsize, 4 * count
        check_expansion(content, memory, stored)
        allow_memory(2 * (content + memory) + stored)  # the file's bytes, and a buffer to convert into
        try:
            data = file.read_bytes()
            data = gzip.decompress(data) if file.suffix.lower() == ".gz" else data
        except (EOFError, OSError, zlib.error) as error:
            raise missing_voxels() from error
        if len(data) < proxy.offset + content:
            raise missing_voxels()
        # i runs fastest: read in C's order the indices are k, j, i
        values = np.frombuffer(data, proxy.dtype, count, proxy.offset).reshape(grid.size[::-1])
        values = values.astype(np.float32)
        if (proxy.slope, proxy.inter) != (1.0, 0.0):
            values *= np.float32(proxy.slope)
            values += np.float32(proxy.inter)
        fill_unknown(values, notes, labels=labels)
    arrays["values"] = values
    grid = VoxelGrid(grid.size, grid.origin, grid.spacing, orthogonalize(grid.direction))
    return {**grid_to_json(grid), "warnings": notes}


def _choose_form(
    qform: Floats, sform: Floats, codes: tuple[int, int], steps: Floats, shape: list[int], notes: list[str]
) -> Floats:
    """Return the affine (4, 4), RAS, mm, by which a file says where its voxels stand.

    `codes`: of both forms; 0: it is not stated.
    `steps`: (3,); spacing by pixdim, mm.

    DataError if none is stated, or two that differ.
    """
    if not any(codes):
        raise refusal("""does not state where it stands in the patient: qform_code and sform_code are 0
            expected: a NIfTI header with a qform or an sform
            fix: convert the scan from its DICOM series again""")
    stated = sform if codes[1] else qform
    own = np.linalg.norm(stated[:3, :3], axis=0)
    # of slices that lean, files state the step from one to the next, or the distance of their planes
    across = np.cross(stated[:3, 0], stated[:3, 1])
    apart = abs(float(np.linalg.det(stated[:3, :3]))) / max(float(np.linalg.norm(across)), 1e-30)
    if not any(
        np.allclose([*own[:2], step], steps, rtol=AXES_COSINE_TOLERANCE, atol=0.0) for step in (own[2], apart)
    ):
        raise refusal(f"""has two spacings: {steps.tolist()} mm by pixdim, {own.round(6).tolist()} mm
                by its {"sform" if codes[1] else "qform"}
            expected: the same spacing in both
            fix: convert the scan from its DICOM series again""")
    axes = sform[:3, :3] / np.linalg.norm(sform[:3, :3], axis=0)
    left, _, right = np.linalg.svd(np.nan_to_num(axes))
    straight = np.column_stack([left @ right * steps, sform[:3, 3]])
    # a qform holds no shear: beside a sheared sform it is the nearest rotation
    placed = straight if codes[1] else sform[:3]
    corners = np.array(list(product(*[(0, n - 1) for n in shape], (1,))))
    apart = float(np.linalg.norm((qform[:3] - placed) @ corners.T, axis=0).max())
    # a form whose code is 0 is empty as a rule; one that is not was written once
    empty = not sform[:3, :3].any() or np.allclose(qform[:3], np.column_stack([np.diag(steps), np.zeros(3)]))
    if apart <= own.max() or (empty and not all(codes)):
        return stated
    turn = (qform[:3, :3] / np.linalg.norm(qform[:3, :3], axis=0)).T @ left @ right
    angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
    how = "mirrored" if np.linalg.det(turn) < 0 else f"turned by {angle:.1f} degrees"
    if not all(codes):
        names = ("sform", "qform") if codes[1] else ("qform", "sform")
        notes.append(
            f"the scan's {names[0]} is taken; its {names[1]} (code 0) places the voxels up to {apart:.1f} mm "
            f"elsewhere, {how}"
        )
        return stated
    raise refusal(f"""its sform and its qform place the voxels up to {apart:.1f} mm apart, {how}
        expected: one place of the scan in the patient
        fix: convert the scan from its DICOM series again, or set the code of the wrong one to 0""")
