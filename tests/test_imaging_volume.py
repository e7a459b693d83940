"""Volumes: their coordinates, and NRRD, NIfTI and MetaImage files written byte by byte."""

import gzip
import resource
from functools import partial

import nibabel
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pytest import approx
from reading_here import child_process_reader, read_here  # noqa: F401
from refusals import refused_file
from scanner.write import write_volume

from needlefit.errors import DataError
from needlefit.imaging.volume import Volume, doubt_air, explain_refusal, to_index, to_patient
from needlefit.imaging.volume_files import list_series_files, read_volume

pytestmark = pytest.mark.usefixtures("read_here")

VALUES = np.arange(2 * 3 * 4, dtype=np.int16).reshape(2, 3, 4)  # slices, rows, columns
STEPS, CORNER = (0.4, 0.5, 0.9), (1.0, 2.0, 3.0)
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


def nifti(path, values=VALUES, affine=PLAIN, codes=(0, 1), unit="mm", **entries):
    """Write a NIfTI-1 file whose affine leads to RAS; `entries` replace those of the header."""
    image = nibabel.Nifti1Image(values.T, affine)
    image.set_qform(affine, codes[0])
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


def volume_of(values, direction=None, origin=CORNER, spacing=STEPS):
    direction = np.eye(3) if direction is None else direction
    return Volume(np.asarray(values, np.float32), np.array(origin), np.array(spacing), direction)


# Coordinates


@st.composite
def directions(draw):
    """Orthonormal axes of either handedness."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.where(rng.random(3) < 0.5, -1.0, 1.0)


def test_known_points_and_invalid_volumes():
    # i runs to the back, j down, k to the left; values are [slice, row, column].
    direction = np.array([[0, 0, 1], [1, 0, 0], [0, -1, 0]], dtype=float)
    volume = volume_of(VALUES, direction)
    assert to_patient(volume, [[3, 2, 1]])[0] == approx([1 + 0.9, 2 + 1.2, 3 - 1.0])
    assert volume.grid.size == (4, 3, 2)
    assert to_index(volume, [[1.9, 3.2, 2.0]])[0] == approx([3, 2, 1])
    for wrong, words in [
        ({"values": np.zeros((3, 3, 1))}, "1 x 3 x 3 voxels"),
        ({"direction": np.eye(3) * 1.1}, "not perpendicular"),
        ({"spacing": (0.4, -0.5, 0.9)}, "spacing"),
        ({"origin": (np.nan, 0, 0)}, "not finite"),
    ]:
        with pytest.raises(DataError) as error:
            volume_of(**{"values": VALUES} | wrong)
        assert words in str(error.value)


# Coordinate systems of files


def check_plain(volume, direction=(1, 1, 1), origin=CORNER):
    assert volume.values.dtype == np.float32 and np.array_equal(volume.values, VALUES)
    assert volume.spacing == approx(STEPS, abs=1e-7)
    assert volume.origin == approx(origin, abs=1e-6)
    assert volume.direction == approx(np.diag(np.array(direction, dtype=float)), abs=1e-7)


@pytest.mark.parametrize(
    ("space", "signs"),
    [
        ("LPS", (1, 1, 1)),
        ("right-anterior-superior", (-1, -1, 1)),
        ("left-anterior-superior", (1, -1, 1)),
    ],
)
def test_nrrd_spaces_become_lps(tmp_path, space, signs):
    """A point 1 mm to the right is at x = -1 in LPS; values stay in the order of the file."""
    check_plain(read_volume(nrrd(tmp_path / "a.nrrd", space=space)), signs, np.array(CORNER) * signs)


def test_nifti_is_ras_and_metaimage_lps(tmp_path):
    check_plain(read_volume(nifti(tmp_path / "a.nii.gz")), (-1, -1, 1), (-1.0, -2.0, 3.0))
    volume = read_volume(nifti(tmp_path / "a.nii", scl_slope=0.5, scl_inter=-10.0))
    assert np.array_equal(volume.values, VALUES * 0.5 - 10.0)
    check_plain(read_volume(metaimage(tmp_path / "a.mha")))
    # A qform turned 180 degrees about z, with qfac -1: i left, j posterior, k inferior.
    turned = PLAIN * [[-1, -1, 1, 1], [1, -1, 1, 1], [1, 1, -1, 1], [1, 1, 1, 1]]
    volume = read_volume(nifti(tmp_path / "a.nii", affine=turned, codes=(1, 0)))
    check_plain(volume, (1, 1, -1), (-1.0, -2.0, 3.0))
    assert "micron" in refused(nifti(tmp_path / "a.nii", unit="micron")).what


def test_a_file_whose_space_is_not_stated(tmp_path):
    path = nrrd(tmp_path / "a.nrrd")  # the dimension must stand where `space` stood
    path.write_bytes(path.read_bytes().replace(b"space: left-posterior-superior", b"space dimension: 3"))
    assert "does not state its space" in refused(path).what


# Round trips


@pytest.mark.parametrize(
    ("name", "tolerance"), [("a.nrrd", 1e-9), ("a.mha", 1e-6), ("a.nii.gz", 2e-5), ("a.nii", 2e-5)]
)
@settings(max_examples=6)
@given(direction=directions(), seed=st.integers(0, 2**32 - 1), whole=st.booleans())
def test_written_and_read(tmp_path_factory, name, tolerance, direction, seed, whole):
    """NIfTI keeps its geometry in single precision, so it is as exact as that."""
    rng = np.random.default_rng(seed)
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


def test_a_header_with_detached_voxels_and_non_finite_values(tmp_path):
    path = nrrd(tmp_path / "a.nhdr", data=b"", data_file="gone.raw")
    assert "gone.raw" in refused(path).what
    (tmp_path / "gone.raw").write_bytes(VALUES.tobytes()[:-4])
    assert "not all there" in refused(path).what
    (tmp_path / "gone.raw").write_bytes(VALUES.tobytes())
    check_plain(read_volume(path))
    assert list_series_files(path) == [path, tmp_path / "gone.raw"]
    values = VALUES.astype(np.float32)
    values[0, 0, :2] = np.nan, np.inf
    fault = refused(nrrd(tmp_path / "a.nrrd", values, type="float"))
    assert "2 to inf" in fault.what and "air" in fault.fix


def test_a_nifti_file_whose_two_forms_differ_is_refused(tmp_path):
    image = nibabel.Nifti1Image(VALUES.T, PLAIN)
    for away, is_right in ((0.3, True), (40.0, False)):
        other = PLAIN.copy()
        other[2, 3] += away
        image.set_qform(other, 1)
        image.set_sform(PLAIN, 1)
        nibabel.save(image, tmp_path / "a.nii")
        if is_right:
            assert read_volume(tmp_path / "a.nii").origin == approx([-1.0, -2.0, 3.0], abs=1e-6)
        else:
            assert "40 mm" in refused(tmp_path / "a.nii").what


def test_what_a_header_leaves_out_is_not_made_up(tmp_path):
    path, data = metaimage(tmp_path / "a.mhd", ElementDataFile="a.raw"), VALUES.tobytes()
    (tmp_path / "a.raw").write_bytes(data)
    check_plain(read_volume(path))
    (tmp_path / "a.raw").write_bytes(bytes(100) + data)
    for one in (path, nrrd(tmp_path / "a.nhdr", data=b"", data_file="a.raw")):
        assert "148" in refused(one).what
    path.write_bytes(path.read_bytes().replace(b"ElementSpacing", b"Spacing"))
    assert "ElementSpacing" in refused(path).expected


@pytest.mark.parametrize(("shift", "filled"), [(-5.0, -1000.0), (0.0, 0.0), (-2000.0, -2000.0)])
def test_voxels_without_a_value_are_air_where_values_are_hounsfield_units(tmp_path, shift, filled):
    values = VALUES.astype(np.float32) + np.float32(shift)
    values[1, 2, 3] = values[0, 0, 1] = np.nan
    for path in (
        nrrd(tmp_path / "a.nrrd", values, type="float"),
        nifti(tmp_path / "a.nii", values),
    ):
        volume = read_volume(path)
        assert np.array_equal(volume.values, np.where(np.isnan(values), filled, values))
        (warning,) = volume.warnings
        assert "2 of 24 voxels (8.3 %)" in warning and "= 1, 0, 0:" in warning


TILT = np.radians(12.0)


@pytest.mark.parametrize("name", ["a.nii", "a.nrrd"])
def test_slices_of_a_tilted_gantry_stand_where_their_affine_says(tmp_path, name):
    """The third axis leans by 12 degrees; NIfTI states the distance of the slices, not their step."""
    lean, signs = 0.9 * np.tan(TILT), np.ones(3)
    if name == "a.nii":
        signs[:2] = -1
        affine = PLAIN + np.eye(4)[1][:, None] * [0, 0, lean, 0]
        volume = read_volume(nifti(tmp_path / name, affine=affine, pixdim=[1, 0.4, 0.5, 0.9, 1, 1, 1, 1]))
    else:
        volume = read_volume(nrrd(tmp_path / name, space_directions=f"(0.4,0,0) (0,0.5,0) (0,{lean},0.9)"))
    assert to_patient(volume, [[2, 1, 1]])[0] == approx(signs * [1.8, 2.5 + lean, 3.9], abs=1e-5)
    assert to_index(volume, to_patient(volume, [[2.5, 1.25, 0.75]]))[0] == approx([2.5, 1.25, 0.75])
    assert volume.grid.slice_distance == approx(0.9, abs=1e-6)
    assert volume.grid.normal == approx([0, 0, 1], abs=1e-6)
    assert np.array_equal(volume.values, VALUES)


@pytest.mark.usefixtures("child_process_reader")
def test_a_header_that_claims_a_petabyte_is_refused_before_anything_is_allocated(tmp_path):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    huge = "100000 100000 100000"  # a petabyte
    bombs = [
        nrrd(tmp_path / "a.nrrd", sizes=huge),
        nrrd(tmp_path / "b.nrrd", sizes=huge, encoding="gzip"),
        nifti(tmp_path / "d.nii", dim=[3, *3 * [32767], 1, 1, 1, 1]),
        nifti(tmp_path / "e.nii.gz", dim=[3, *3 * [32767], 1, 1, 1, 1]),
        metaimage(tmp_path / "f.mha", DimSize=huge),
    ]
    for path in bombs:
        fault = refused(path)
        assert "claims" in fault.what or "too large" in fault.what
    assert "1e+15 GB" not in fault.what and "4e+06 GB" in fault.what
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50e3  # kB


FOUR_AXES = {
    "NDims": 4,
    "DimSize": "2 3 2 2",
    "TransformMatrix": " ".join(map(str, np.eye(4).ravel())),
    "Offset": "0 0 0 0",
    "ElementSpacing": "1 1 1 1",
}
SINGLE, SHEARED = ("be read as a volume", "time points"), ("not perpendicular", "resample")
SPACED = ("spacing", "")
TIMES = {"space_directions": "(1,0,0) (0,1,0) (0,0,1) none"}


@pytest.mark.parametrize(
    ("air", "soft", "padding", "is_doubted"),
    [
        (-1000, 40, None, False),
        (-1000, 40, -3024, False),
        (-669, 70, -1000, True),
        (-450, 300, -1024, True),
        (None, 40, None, False),  # no air in the field
        (-120, 40, None, False),  # fat beside water
    ],
)
def test_the_level_of_air_is_that_of_hounsfield_units(air, soft, padding, is_doubted):
    random = np.random.default_rng(3)
    values = random.normal(soft, 60.0, (8, 40, 40))
    if air is not None:
        values[:, :20] = random.normal(air, 40.0, (8, 20, 40))
    values[:, 30:33, 30:33] = random.normal(-400.0, 300.0, (8, 3, 3))  # streaks
    if padding is not None:
        values[:, :4] = padding
        values = np.maximum(values, padding)
    volume = volume_of(values)
    assert bool([*doubt_air(volume)]) == is_doubted
    refusal = explain_refusal(DataError("no needle", where="a.nrrd"), volume)
    assert refusal.where == "a.nrrd" and refusal.what.startswith("no needle") != is_doubted
    assert "16 x 20 x 7.2 mm" in refusal.what and f"{values.min():.5g} to {values.max():.5g}" in refusal.what


@pytest.mark.parametrize("offset", [0.0, 1000.0])
@pytest.mark.parametrize("padding", [None, -2000.0])
def test_a_volume_in_which_nothing_is_as_dark_as_air_has_a_doubt_about_its_unit(offset, padding):
    values = np.random.default_rng(4).normal(20.0, 30.0, (8, 40, 40))
    values[:, :38] -= 1020.0
    values += offset
    if padding is not None:
        values[:, :4] = padding
    assert bool([*doubt_air(volume_of(values))]) == (offset > 0)


@pytest.mark.parametrize(
    ("name", "arguments", "words"),
    [
        ("a.nrrd", {"values": VALUES.reshape(2, 2, 3, 2), **TIMES}, SINGLE),
        ("a.nii", {"dim": [4, 2, 3, 2, 2, 1, 1, 1]}, SINGLE),
        ("a.mha", FOUR_AXES, SINGLE),
        ("a.nii", {"values": VALUES[:1]}, ("4 x 3 x 1 voxels", "")),
        ("a.nrrd", {"space": "scanner-xyz"}, ("its space is scanner-xyz", "")),
        ("a.nii", {"codes": (0, 0)}, ("qform_code and sform_code", "")),
        ("a.nrrd", {"space_directions": "(0.4,0,0) (0.1,0.5,0) (0,0,0.9)"}, SHEARED),
        ("a.nii", {"affine": PLAIN + 0.72 * np.eye(4)[[3, 2, 3, 3]]}, SHEARED),
        ("a.nrrd", {"space_directions": "(0.0004,0,0) (0,0.0005,0) (0,0,0.0009)"}, SPACED),
        ("a.mha", {"ElementSpacing": "400 500 900"}, SPACED),
    ],
)
def test_geometries_that_are_no_volume_s(tmp_path, name, arguments, words):
    make = {"a.nrrd": nrrd, "a.nii": nifti, "a.mha": metaimage}[name]
    fault = refused(make(tmp_path / name, **arguments))
    assert words[0] in fault.what and words[1] in fault.fix
