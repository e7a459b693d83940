"""Volumes: their coordinates, and NRRD, NIfTI and MetaImage files written byte by byte."""

import gzip
import resource
from functools import partial
from pathlib import Path

import nibabel
import numpy as np
import pytest
import slicerio
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from pytest import approx
from reading_here import child_process_reader, read_here  # noqa: F401
from refusals import refused_file
from scanner.write import write_volume

from needlefit.errors import DataError
from needlefit.imaging.segmentations import read_labels
from needlefit.imaging.volume import Volume, doubt_air, explain_refusal, to_index, to_patient
from needlefit.imaging.volume_files import list_series_files, read_volume

pytestmark = pytest.mark.usefixtures("read_here")

VALUES = np.arange(2 * 3 * 4, dtype=np.int16).reshape(2, 3, 4)  # slices, rows, columns
STEPS, CORNER = (0.4, 0.5, 0.9), (1.0, 2.0, 3.0)
HALF = np.arange(40)[:, None] < 20  # of the rows of a slice
PLAIN = np.array([[0.4, 0, 0, 1], [0, 0.5, 0, 2], [0, 0, 0.9, 3], [0, 0, 0, 1]])


refused = partial(refused_file, read_volume)


def nrrd(path, values=VALUES, data=None, **fields):
    """Write an NRRD file; `fields` replace or, with None, remove lines of its header."""
    fields = {
        "type": "short",
        "dimension": values.ndim,
        "space": "left-posterior-superior",
        "sizes": " ".join(map(str, values.shape[::-1])),
        "space directions": "(0.4,0,0) (0,0.5,0) (0,0,0.9)",
        "endian": "little",
        "encoding": "raw",
        "space origin": "(1,2,3)",
    } | {key.replace("_", " "): value for key, value in fields.items()}
    lines = [f"{key}: {value}" for key, value in fields.items() if value is not None]
    header = "\n".join(["NRRD0004", *lines]) + "\n\n"
    path.write_bytes(header.encode() + (values.tobytes() if data is None else data))
    return path


def nifti(path, values=VALUES, affine=PLAIN, codes=(0, 1), unit="mm", shift=0.0, **entries):
    """Write a NIfTI-1 file whose affine leads to RAS, its qform `shift` mm up; `entries` of its header."""
    image = nibabel.Nifti1Image(values.T, affine)
    image.set_qform(affine + shift * np.eye(4)[2][:, None] * np.eye(4)[3], codes[0])
    image.set_sform(affine, codes[1])
    image.header.set_xyzt_units(unit)
    for name, value in ({"vox_offset": 352} | entries).items():
        image.header[name] = value
    with gzip.open(path, "wb") if path.suffix == ".gz" else path.open("wb") as file:
        file.write(image.header.binaryblock + bytes(4) + values.tobytes())
    return path


def metaimage(path, **fields):
    fields = {
        "ObjectType": "Image",
        "NDims": 3,
        "BinaryData": "True",
        "BinaryDataByteOrderMSB": "False",
        "TransformMatrix": "1 0 0 0 1 0 0 0 1",
        "Offset": "1 2 3",
        "ElementSpacing": "0.4 0.5 0.9",
        "DimSize": "4 3 2",
        "ElementType": "MET_SHORT",
        "ElementDataFile": "LOCAL",
    } | fields
    header = "".join(f"{key} = {value}\n" for key, value in fields.items())
    path.write_bytes(header.encode() + VALUES.tobytes())
    return path


NAMES = {nrrd: "a.nrrd", nifti: "a.nii", metaimage: "a.mha"}


def volume_of(values, direction=None, origin=CORNER, spacing=STEPS):
    direction = np.eye(3) if direction is None else direction
    return Volume(np.asarray(values, np.float32), np.array(origin), np.array(spacing), direction)


# Coordinates


def test_known_points():
    # i runs to the back, j down, k to the left; values are [slice, row, column].
    volume = volume_of(VALUES, np.array([[0, 0, 1], [1, 0, 0], [0, -1, 0]], dtype=float))
    assert volume.grid.size == (4, 3, 2)
    place = [[1 + 0.9, 2 + 1.2, 3 - 1.0]]
    assert_allclose(to_patient(volume, [[3, 2, 1]]), place)
    assert_allclose(to_index(volume, place), [[3, 2, 1]])


# Coordinate systems of files


def check_plain(volume, direction=(1, 1, 1), origin=CORNER):
    assert volume.values.dtype == np.float32 and np.array_equal(volume.values, VALUES)
    assert volume.spacing == approx(STEPS, abs=1e-7)
    assert volume.origin == approx(origin, abs=1e-6)
    assert volume.direction == approx(np.diag(np.array(direction, dtype=float)), abs=1e-7)


@pytest.mark.parametrize(("space", "signs"), [("LPS", (1, 1, 1)), ("left-anterior-superior", (1, -1, 1))])
def test_nrrd_spaces_become_lps(tmp_path, space, signs):
    """A point 1 mm to the right is at x = -1 in LPS; values stay in the order of the file."""
    check_plain(read_volume(nrrd(tmp_path / "a.nrrd", space=space)), signs, np.array(CORNER) * signs)


def test_nifti_is_ras_and_metaimage_lps(tmp_path):
    check_plain(read_volume(nifti(tmp_path / "a.nii.gz")), (-1, -1, 1), (-1.0, -2.0, 3.0))
    volume = read_volume(nifti(tmp_path / "a.nii", scl_slope=0.5, scl_inter=-10.0))
    assert np.array_equal(volume.values, VALUES * 0.5 - 10.0)
    check_plain(
        read_volume(nifti(tmp_path / "a.nii", codes=(1, 1), shift=0.3)), (-1, -1, 1), (-1.0, -2.0, 3.0)
    )
    check_plain(read_volume(metaimage(tmp_path / "a.mha")))
    # A qform turned 180 degrees about z, with qfac -1: i left, j posterior, k inferior.
    turned = PLAIN * [[-1, -1, 1, 1], [1, -1, 1, 1], [1, 1, -1, 1], [1, 1, 1, 1]]
    volume = read_volume(nifti(tmp_path / "a.nii", affine=turned, codes=(1, 0)))
    check_plain(volume, (1, 1, -1), (-1.0, -2.0, 3.0))


# Round trips


@pytest.mark.parametrize(
    ("name", "tolerance"), [("a.nrrd", 1e-9), ("a.mha", 1e-6), ("a.nii.gz", 2e-5), ("a.nii", 2e-5)]
)
@settings(max_examples=6)
@given(seed=st.integers(0, 2**32 - 1), whole=st.booleans())
def test_written_and_read(tmp_path_factory, name, tolerance, seed, whole):
    """NIfTI keeps its geometry in single precision, so it is as exact as that."""
    rng = np.random.default_rng(seed)
    direction = np.linalg.qr(rng.normal(size=(3, 3)))[0] * rng.choice([-1.0, 1.0], 3)  # of either handedness
    values = (rng.normal(size=(3, 4, 5)) * 1000).astype(np.float32)
    values = np.round(values) + 0.0 if whole else values  # whole numbers have no -0
    volume = volume_of(values, direction, rng.uniform(-100, 100, 3), rng.uniform(0.2, 2.0, 3))
    path = tmp_path_factory.mktemp("v") / name
    write_volume(volume, path)
    again = read_volume(path)
    assert again.values.tobytes() == volume.values.tobytes()
    corners = np.argwhere(np.ones((2, 2, 2))) * [4, 3, 2]
    assert np.abs(to_patient(again, corners) - to_patient(volume, corners)).max() < tolerance


# What is refused


@pytest.mark.parametrize("name", ["a.nrrd", "a.mha", "a.nii", "a.nii.gz"])
def test_a_file_cut_short(tmp_path, name):
    path, values = tmp_path / name, np.random.default_rng(1).integers(-1000, 1000, (10, 20, 20))
    write_volume(volume_of(values), path)
    path.write_bytes(path.read_bytes()[: int(0.9 * path.stat().st_size)])
    fault = refused(path)
    assert "not all there" in fault.what and "cut short" in fault.fix and "Reason" not in fault.what


def test_a_header_and_the_voxels_beside_it(tmp_path):
    data, voxels = VALUES.tobytes(), tmp_path / "a.raw"
    paths = [
        nrrd(tmp_path / "a.nhdr", data=b"", data_file="a.raw"),
        metaimage(tmp_path / "a.mhd", ElementDataFile="a.raw"),
    ]
    for path in paths:
        voxels.unlink(missing_ok=True)
        assert "not all there" in refused(path).what
        for content, words in ((data[:-4], "not all there"), (bytes(100) + data, "148")):
            voxels.write_bytes(content)
            assert words in refused(path).what
        voxels.write_bytes(data)
        check_plain(read_volume(path))
        assert list_series_files(path) == [path, voxels]
    behind_header = bytes(2**16) + b"\nElementSpacing = 1 1 1"
    path.write_bytes(path.read_bytes().replace(b"ElementSpacing", b"Spacing") + behind_header)
    assert "ElementSpacing" in refused(path).expected


@pytest.mark.parametrize(("shift", "filled"), [(-5.0, -1000.0), (0.0, 0.0), (-2000.0, -2000.0)])
def test_voxels_without_a_value_are_air_where_values_are_hounsfield_units(tmp_path, shift, filled):
    values = VALUES.astype(np.float32) + np.float32(shift)
    values[1, 2, 3] = values[0, 0, 1] = np.nan
    volume = read_volume(nrrd(tmp_path / "a.nrrd", values, type="float"))
    assert np.array_equal(volume.values, np.where(np.isnan(values), filled, values))
    (warning,) = volume.warnings
    assert "2 of 24 voxels (8.3 %)" in warning and "= 1, 0, 0:" in warning


LEAN = 0.9 * np.tan(np.radians(12.0))  # of the third axis; NIfTI states the distance of the slices


@pytest.mark.parametrize(
    ("write", "signs", "fields"),
    [
        (nrrd, (1, 1, 1), {"space_directions": f"(0.4,0,0) (0,0.5,0) (0,{LEAN},0.9)"}),
        (
            nifti,
            (-1, -1, 1),
            {
                "affine": PLAIN + np.eye(4)[1][:, None] * [0, 0, LEAN, 0],
                "pixdim": [1, 0.4, 0.5, 0.9, 1, 1, 1, 1],
            },
        ),
    ],
)
def test_slices_of_a_tilted_gantry_stand_where_their_affine_says(tmp_path, write, signs, fields):
    volume = read_volume(write(tmp_path / NAMES[write], **fields))
    assert to_patient(volume, [[2, 1, 1]])[0] == approx(signs * np.array([1.8, 2.5 + LEAN, 3.9]), abs=1e-5)
    assert to_index(volume, to_patient(volume, [[2.5, 1.25, 0.75]]))[0] == approx([2.5, 1.25, 0.75])
    assert volume.grid.slice_distance == approx(0.9, abs=1e-6)
    assert volume.grid.normal == approx([0, 0, 1], abs=1e-6)
    assert np.array_equal(volume.values, VALUES)


@pytest.mark.usefixtures("child_process_reader")
def test_a_header_that_claims_a_petabyte_is_refused_before_anything_is_allocated(tmp_path):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    huge = "100000 100000 100000"  # a petabyte
    bombs = [
        nrrd(tmp_path / "b.nrrd", sizes=huge, encoding="gzip"),
        nifti(tmp_path / "e.nii.gz", dim=[3, *3 * [32767], 1, 1, 1, 1]),
        metaimage(tmp_path / "f.mha", DimSize=huge),
    ]
    faults = [refused(path).what for path in bombs]
    assert all("claims" in what or "too large" in what for what in faults) and "4e+06 GB" in faults[-1]
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50e3  # kB


STREAKS = np.zeros((40, 40), bool)
STREAKS[30:33, 30:33] = True


def noise(level):
    return np.random.default_rng(3).normal(level, 40.0, (8, 40, 40))


def half(level):
    """Half of the volume is of a level, half is water."""
    return np.where(HALF, noise(level), noise(40))


@pytest.mark.parametrize(
    ("values", "is_doubted"),
    [
        (half(-1000), False),
        (half(-1000).clip(-1024), False),
        (half(-669), True),
        (half(-450), True),
        (np.where(STREAKS, noise(-400), noise(40)), False),  # no air in the field
        (np.where(STREAKS, noise(-400), half(-120)), False),  # fat beside water
        (noise(1000), True),  # nothing is as dark as air
    ],
)
@pytest.mark.parametrize("padding", [None, -3024])
def test_the_level_of_air_is_that_of_hounsfield_units(values, is_doubted, padding):
    values = values.copy()
    values[:, :4] = values[:, :4] if padding is None else padding
    volume = volume_of(values)
    assert bool([*doubt_air(volume)]) == is_doubted
    fault = explain_refusal(DataError("no needle", where="a.nrrd"), volume)
    assert fault.where == "a.nrrd" and fault.what.startswith("no needle") != is_doubted
    assert "16 x 20 x 7.2 mm" in fault.what and f"{values.min():.5g} to {values.max():.5g}" in fault.what


FOUR_AXES = {
    "NDims": 4,
    "DimSize": "2 3 2 2",
    "TransformMatrix": " ".join(map(str, np.eye(4).ravel())),
    "Offset": "0 0 0 0",
    "ElementSpacing": "1 1 1 1",
}
SINGLE, SHEARED, NOT_STATED = "be read as a volume", "not perpendicular", "its space is not stated"
ENDLESS = np.where(VALUES == 0, np.nan, np.where(VALUES == 2, np.inf, VALUES)).astype(np.float32)
TIMES = {"space_directions": "(1,0,0) (0,1,0) (0,0,1) none"}


@pytest.mark.parametrize(
    ("write", "arguments", "words"),
    [
        (nrrd, {"values": VALUES.reshape(2, 2, 3, 2), **TIMES}, SINGLE),
        (nifti, {"dim": [4, 2, 3, 2, 2, 1, 1, 1]}, SINGLE),
        (metaimage, FOUR_AXES, SINGLE),
        (nifti, {"values": VALUES[:1]}, "4 x 3 x 1 voxels"),
        (nifti, {"unit": "micron"}, "micron"),
        (nifti, {"affine": PLAIN * [1, 1, 1, np.inf]}, "not finite"),
        (nrrd, {"space": None, "dimension": "3\nspace dimension: 3"}, NOT_STATED),
        (nrrd, {"space": "scanner-xyz"}, "its space is scanner-xyz"),
        (nifti, {"codes": (0, 0)}, "qform_code and sform_code"),
        (nifti, {"codes": (1, 1), "shift": 40.0}, "40 mm"),
        (nrrd, {"values": ENDLESS, "type": "float"}, "1 to inf"),
        (nrrd, {"space_directions": "(0.4,0,0) (0.1,0.5,0) (0,0,0.9)"}, SHEARED),
        (nifti, {"affine": PLAIN + 0.72 * np.eye(4)[[3, 2, 3, 3]]}, SHEARED),
        (nrrd, {"space_directions": "(0.0004,0,0) (0,0.0005,0) (0,0,0.0009)"}, "spacing"),
        (metaimage, {"ElementSpacing": "400 500 900"}, "spacing"),
    ],
)
def test_files_that_are_no_volume(tmp_path, write, arguments, words):
    assert words in refused(write(tmp_path / NAMES[write], **arguments)).what


def test_a_segmentation_of_slicer():
    path = Path(slicerio.__file__).parent / "data" / "Segmentation.seg.nrrd"
    expected = slicerio.read_segmentation(str(path))
    labels = read_labels(path)
    assert labels.names == {one["labelValue"]: one["name"] for one in expected["segments"]}
    assert np.array_equal(labels.volume.values, expected["voxels"].T)
    ijk, matrix = [[0, 0, 0], [3, 5, 7]], np.asarray(expected["ijkToLPS"])
    assert_allclose(to_patient(labels.volume, ijk), ijk @ matrix[:3, :3].T + matrix[:3, 3])
