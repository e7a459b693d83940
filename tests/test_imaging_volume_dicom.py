"""DICOM series: what is read, and what is refused before a voxel is read."""

import resource
from functools import partial

import numpy as np
import pytest
from dicom_series import COLUMNS, COUNT, NUMBERS, ROWS, a_slice, save, save_volume, series
from hypothesis import given, settings
from hypothesis import strategies as st
from pydicom.uid import (
    BasicTextSRStorage,
    HTJ2KLossless,
    RLELossless,
    SecondaryCaptureImageStorage,
    generate_uid,
)
from pytest import approx
from reading_here import child_process_reader, read_here  # noqa: F401
from refusals import refused_file
from scipy.spatial.transform import Rotation

from needlefit.errors import DataError
from needlefit.imaging.volume import Volume, to_index, to_patient
from needlefit.imaging.volume_files import read_volume

pytestmark = pytest.mark.usefixtures("read_here")

OVERVIEW = {"ImageType": ["ORIGINAL", "PRIMARY", "LOCALIZER"]}


refused = partial(refused_file, read_volume)


def spoilt(k, **entries):
    """Return a sound series but for entries of slice `k`."""
    slices = series()
    slices[k] = a_slice(k, **entries)
    return slices


def turned_slices(radians, step):
    """Return slices that face `radians` off z, `step` (3,) mm apart."""
    axes = [1, 0, 0, 0, round(np.cos(radians), 8), round(np.sin(radians), 8)]
    places = [[round(k * float(along), 6) for along in step] for k in range(COUNT)]
    return [a_slice(k, ImageOrientationPatient=axes, ImagePositionPatient=places[k]) for k in range(COUNT)]


# What is read


def test_each_slice_of_successive_acquisitions_has_its_rescaling_of_an_unspecified_unit(tmp_path):
    slopes, plain = 0.5 + 0.25 * np.arange(COUNT), {"RescaleIntercept": -1024.5, "RescaleType": "US"}
    slices = [
        a_slice(k, RescaleSlope=str(slope), AcquisitionNumber=k, **plain) for k, slope in enumerate(slopes)
    ]
    values = read_volume(save(tmp_path, slices)).values
    assert np.array_equal(values, NUMBERS * slopes[:, None, None] - 1024.5)


@pytest.mark.parametrize(("kind", "padding"), [("SS", -2000), ("US", 63536)])  # written without its sign
def test_padding_gets_the_value_of_air(tmp_path, kind, padding):
    planes = NUMBERS + 100
    planes[:, 0, :3] = -2000
    slices = [a_slice(k, plane, RescaleSlope="0.1", RescaleIntercept=-1007) for k, plane in enumerate(planes)]
    for data in slices:
        data.add_new("PixelPaddingValue", kind, padding)
    values = read_volume(save(tmp_path, slices)).values
    assert (values[:, 0, :3] == -1000.0).all() and values.min() == -1000.0


# Which files and which series


def test_the_order_of_files_other_files_and_overviews_mean_nothing(tmp_path):
    save(tmp_path, series(), order=[4, 0, 5, 2, 1, 3])
    for name in ("LOCKFILE", "notes.txt", ".DS_Store"):
        (tmp_path / name).write_text("003")
    within = a_slice(2)
    within.SOPClassUID = within.file_meta.MediaStorageSOPClassUID = BasicTextSRStorage
    within.save_as(tmp_path / "009.dcm", enforce_file_format=True)
    assert np.array_equal(read_volume(tmp_path).values, NUMBERS)
    (tmp_path := tmp_path / "b").mkdir()
    overview = a_slice(0, SeriesInstanceUID=generate_uid(), **OVERVIEW)
    nowhere = {"ImagePositionPatient": None, "ImageOrientationPatient": None}
    other = {"SeriesInstanceUID": generate_uid(), "SOPClassUID": SecondaryCaptureImageStorage}
    dose = a_slice(0, **other, **nowhere)
    assert np.array_equal(read_volume(save(tmp_path, [*series(), overview, dose])).values, NUMBERS)


def test_folders_without_a_series(tmp_path):
    (tmp_path / "inside").mkdir()
    (tmp_path / "notes.txt").write_text("scan")
    for path, words in ((tmp_path, "no series"), (tmp_path / "no", "no such file")):
        assert words in refused(path).what
    assert "not a volume" in refused(tmp_path / "notes.txt").what


def test_localizers_are_left_out(tmp_path):
    volume = read_volume(save(tmp_path / "a", [*series(), a_slice(0, **OVERVIEW)]))
    assert np.array_equal(volume.values, NUMBERS) and len(volume.warnings) == 1
    alone = [a_slice(k, SeriesInstanceUID=generate_uid(), **OVERVIEW) for k in range(2)]
    assert "2 series" in refused(save(tmp_path / "d", alone)).what


def test_a_tilted_gantry_is_read_where_the_slices_stand(tmp_path):
    tilt = np.radians(-15.0)
    volume = read_volume(save(tmp_path, turned_slices(tilt, [0, 0, 2])))
    assert np.array_equal(volume.values, NUMBERS) and not volume.warnings
    assert volume.grid.slice_distance == approx(2 * np.cos(tilt), abs=1e-6)
    expected = [0.8, 0.5 * np.cos(tilt), 0.5 * np.sin(tilt) + 6]
    assert to_patient(volume, [[2, 1, 3]])[0] == approx(expected, abs=1e-5)
    assert to_index(volume, [expected])[0] == approx([2, 1, 3], abs=1e-5)


def test_rounded_headers_of_an_oblique_stack_are_read(tmp_path):
    place, axes, allowed = 1, 3, 0.06
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
    origin, count = np.array([-31.234, 12.345, 77.77]), 60
    stated = [f"{x:.{axes}f}" for x in turn[:, :2].T.ravel()]
    places = [[f"{x:.{place}f}" for x in origin + 0.6 * k * turn[:, 2]] for k in range(count)]
    pages = [a_slice(0, NUMBERS[0], ImagePositionPatient=at, ImageOrientationPatient=stated) for at in places]
    volume = read_volume(save(tmp_path, pages))
    corners = np.array([[0, 0, 0], [COLUMNS - 1, ROWS - 1, count - 1], [COLUMNS - 1, 0, 0]])
    true = corners * [0.4, 0.5, 0.6] @ turn.T + origin
    assert np.linalg.norm(to_patient(volume, corners) - true, axis=1).max() < allowed


def test_a_series_without_its_uid_is_read_and_one_with_a_damaged_file_is_not(tmp_path):
    save(tmp_path, series(SeriesInstanceUID=None))
    assert np.array_equal(read_volume(tmp_path).values, NUMBERS)
    for name, content in (("empty.dcm", b""), ("text.dcm", b"scan" * 99)):
        (tmp_path / name).write_bytes(content)
        assert refused(tmp_path).where.endswith(name)
        (tmp_path / name).unlink()


# What is refused


def undecoded(syntax):
    slices = series()
    for data in slices:
        data.compress(RLELossless)
        data.file_meta.TransferSyntaxUID = syntax
    return slices


THIN = [
    a_slice(k, ImagePositionPatient=[-10.0, 20.0, round(30 + 0.15 * (k + (k > 2)), 6)]) for k in range(COUNT)
]
PADDED = [a_slice(k, np.full((3, 3), -2000, np.int16), PixelPaddingValue=-2000) for k in range(COUNT)]


@pytest.mark.parametrize(
    ("slices", "what", "where", "fix"),
    [
        (PADDED, "nan to nan", "", ""),
        ([*series()[:2], *series()[4:]], "002.dcm stands 2.7 mm behind 001.dcm", "002.dcm", ""),
        (THIN, "003.dcm stands 0.3 mm behind 002.dcm", "003.dcm", ""),  # no slice is 0.1 mm off its place
        ([*series(), a_slice(2, NUMBERS[2] + 1)], "006.dcm stands 0 mm behind 002.dcm", "006.dcm", ""),
        ([*series(), *series()], "stands 0 mm behind", "", ""),
        (series(**OVERVIEW), "is a localizer", "000.dcm", "series"),
        (turned_slices(np.radians(40.0), [0, 0, 5]), "not perpendicular", "000.dcm", "resample"),
        (spoilt(2, ImagePositionPatient=[-9.0, 20.0, 31.8]), "0.9 mm behind 001.dcm and 1 mm", "002.dcm", ""),
        (spoilt(3, ImagePositionPatient=[-10.0, 20.0, 32.5]), "0.7 mm behind 002.dcm", "003.dcm", ""),
        (
            spoilt(4, ImageOrientationPatient=[1, 0, 0, 0, 0.9998, 0.02]),
            "ImageOrientationPatient is",
            "004.dcm",
            "",
        ),
        (spoilt(4, FrameOfReferenceUID=generate_uid()), "FrameOfReferenceUID", "004.dcm", ""),
        (series()[:1], "48 x 64 x 1 voxels", "", ""),
        # enhanced CT keeps its positions inside; it is named for what it is, not for what it lacks
        ([a_slice(0, NumberOfFrames=9, ImagePositionPatient=None)], "NumberOfFrames is 9", "", "NRRD"),
        (undecoded(HTJ2KLossless), HTJ2KLossless.name, "", "uncompressed"),
        *(
            (spoilt(4, **entries), words, "004.dcm", "")
            for entries, words in (
                ({"ImagePositionPatient": None}, "ImagePositionPatient is not stated"),
                ({"PhotometricInterpretation": "MONOCHROME1"}, "MONOCHROME1"),
                ({"PixelSpacing": [0.502, 0.4]}, "PixelSpacing is"),  # its last row lies 0.13 mm off
                ({"RescaleType": "MGML"}, "RescaleType is MGML"),
            )
        ),
    ],
)
def test_slices_that_are_no_stack(tmp_path, slices, what, where, fix):
    fault = refused(save(tmp_path, slices))
    assert what in fault.what and fault.where.endswith(where) and fix in fault.fix


@pytest.mark.parametrize("suffix", ["", ".dcm"])
def test_a_slice_that_is_cut_short_is_named_wherever_it_is_cut(suffix, tmp_path):
    folder = save(tmp_path / "series", series())
    for file in list(folder.iterdir()):
        file.rename(file.with_suffix(suffix))
    for name in ("003", "005"):  # behind the last one nothing is seen to be missing
        file = folder / f"{name}{suffix}"
        whole = file.read_bytes()
        for size in (*range(140, 900, 37), 150, 180, 300, len(whole) // 2):
            file.write_bytes(whole[:size])
            with pytest.raises(DataError) as error:
                read_volume(folder)
            assert error.value.where == str(file) and "again" in error.value.fix, size
        for size in (-60, -1):
            file.write_bytes(whole[:size])
            assert refused(folder).where == str(file)
        file.write_bytes(whole)


@pytest.mark.sweep
@pytest.mark.usefixtures("child_process_reader")
def test_a_header_that_claims_a_huge_volume_is_refused_before_anything_is_allocated(tmp_path):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert "crop" in refused(save(tmp_path, series(Rows=65535, Columns=65535))).fix
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100e3  # kB


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), flip=st.booleans())
def test_every_voxel_keeps_its_position(tmp_path_factory, seed, flip):
    """A left-handed volume comes back right-handed: its slices are the same, in the other order."""
    rng = np.random.default_rng(seed)
    direction, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    direction *= np.linalg.det(direction) * (-1 if flip else 1)
    values = np.round(rng.normal(size=(4, 5, 6)) * 1000.0).astype(np.float32)
    volume = Volume(values, rng.normal(size=3) * 100, rng.uniform(0.2, 2.0, 3), direction)
    folder = tmp_path_factory.mktemp("scan") / "series"
    save_volume(folder, volume)
    again = read_volume(folder)
    assert np.linalg.det(again.direction) == approx(1.0)
    assert np.array_equal(again.values[::-1] if flip else again.values, volume.values)
    here = np.argwhere(np.ones(values.shape))[:, ::-1]
    there = to_index(again, to_patient(volume, here))
    if flip:
        here = here * [1, 1, -1] + [0, 0, 3]
    assert np.abs(there - here).max() < 1e-4
