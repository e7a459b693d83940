"""Contours of RTSTRUCT files as layers and masks, and segments chosen by name."""

from functools import partial

import numpy as np
import pytest
from dicom_series import FRAME
from layer_cases import labelled, save_segments
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, RTStructureSetStorage, generate_uid
from reading_here import child_process_reader, read_here  # noqa: F401
from refusals import refused_file

from needlefit.errors import DataError
from needlefit.imaging.layers import extract_label_surfaces
from needlefit.imaging.scans import LayerSource, parse_layer_source
from needlefit.imaging.segmentations import read_labels

pytestmark = pytest.mark.usefixtures("read_here")

refused = partial(refused_file, read_labels)


def circle(radius, z, centre=(0.0, 0.0), count=180):
    angle = np.arange(count) * 2 * np.pi / count
    x, y = radius * np.cos(angle) + centre[0], radius * np.sin(angle) + centre[1]
    return np.column_stack([x, y, np.full(count, z)])


def write_contours(path, regions, kinds=None, turn=None):
    """Write regions, name -> contours; `kinds` are those of regions whose contours are not closed."""
    data = Dataset()
    data.file_meta = FileMetaDataset()
    data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data.SOPClassUID = data.file_meta.MediaStorageSOPClassUID = RTStructureSetStorage
    data.SOPInstanceUID = data.file_meta.MediaStorageSOPInstanceUID = generate_uid(entropy_srcs=["rt"])
    data.Modality = "RTSTRUCT"
    data.StructureSetROISequence, data.ROIContourSequence = [], []
    for number, (name, contours) in enumerate(regions.items(), 1):
        listed, drawn = Dataset(), Dataset()
        listed.ROINumber, listed.ROIName, drawn.ReferencedROINumber = number, name, number
        listed.ReferencedFrameOfReferenceUID = FRAME
        drawn.ContourSequence = []
        for points in contours:
            one = Dataset()
            one.ContourGeometricType = (kinds or {}).get(name, "CLOSED_PLANAR")
            one.NumberOfContourPoints = len(points)
            points = points if turn is None else points @ turn.T
            one.ContourData = [f"{value:.5f}" for value in points.ravel()]
            drawn.ContourSequence.append(one)
        data.StructureSetROISequence.append(listed)
        data.ROIContourSequence.append(drawn)
    data.save_as(path, enforce_file_format=True)
    return path


HEIGHTS = np.arange(0.0, 40.5, 1.5)


def cylinder(radius, low=0.0, high=40.0, centre=(0.0, 0.0)):
    return [circle(radius, z, centre) for z in HEIGHTS if low <= z <= high]


def turned_about(axis, angle):
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(np.array(axis) * angle).as_matrix()


@pytest.mark.parametrize("turn", [None, turned_about([0.6, 0.0, 0.8], 0.5)])
def test_contours_become_closed_surfaces(tmp_path, turn):
    inner = [circle(8.0, z) for z in HEIGHTS if 9.0 <= z <= 30.0]
    path = write_contours(tmp_path / "rt.dcm", {"Body": cylinder(20.0), "Core": inner}, turn=turn)
    body, core = extract_label_surfaces(path)
    for surface, radius, low, high in ((body, 20.0, 0.0, 39.0), (core, 8.0, 9.0, 30.0)):
        points = surface.mesh.vertices if turn is None else surface.mesh.vertices @ turn
        assert surface.mesh.is_watertight
        middle = points[np.abs(points[:, 2] - 20) < 8]
        assert np.linalg.norm(middle[:, :2], axis=1).mean() == pytest.approx(radius, abs=0.1)
        assert points[:, 2].min() == pytest.approx(low - 0.75, abs=0.05)
        assert points[:, 2].max() == pytest.approx(high + 0.75, abs=0.05)


@pytest.mark.usefixtures("child_process_reader")
def test_contours_within_contours_are_holes(tmp_path):
    ring = [one for z in HEIGHTS for one in (circle(20.0, z), circle(10.0, z))]
    values = read_labels(write_contours(tmp_path / "rt.dcm", {"Ring": ring})).volume
    pixel = values.spacing[0] * values.spacing[1]
    area = np.count_nonzero(values.values[5]) * pixel
    assert area == pytest.approx(np.pi * 300, rel=0.005) and values.spacing[2] == pytest.approx(1.5)


def test_of_regions_that_lie_in_one_another_the_inner_one_comes_later(tmp_path):
    regions = {"Core": cylinder(8.0), "Body": cylinder(20.0), "Beside": cylinder(5.0, centre=(40.0, 0.0))}
    path = write_contours(tmp_path / "rt.dcm", regions)
    fault = refused(path)
    assert "Core" in fault.what and "segments:" in fault.fix
    labels = read_labels(path, ("Body", "Core"))
    assert [one.name for one in labels.segments] == ["Body", "Core"]


def test_segments_are_chosen_by_name_in_any_file(tmp_path):
    path = write_contours(tmp_path / "s.dcm", {"Body": cylinder(20.0), "Core": cylinder(8.0)})
    labels = read_labels(path, ("core",))
    assert [one.name for one in labels.segments] == ["Core"]
    assert "bone" in refused(path, ("bone",)).what and "Core" in refused(path, ("bone",)).expected
    nrrd = save_segments(
        tmp_path / "l.seg.nrrd", [labelled(lambda p: 1 + (p[:, 0] > 0))], [(1, "skin"), (2, "fat")]
    )
    (fat,) = extract_label_surfaces(nrrd, ("fat",))
    assert fat.into == 1 and fat.mesh.bounds[0] @ [1, 0, 0] == pytest.approx(0, abs=0.1)
    source = parse_layer_source("s.dcm=segments:Body, Core", tmp_path)
    assert source == LayerSource(path, segments=("Body", "Core"))
    assert isinstance(parse_layer_source("s.dcm=solid:2", tmp_path), DataError)


def test_points_are_left_out_and_open_or_damaged_contours_refused(tmp_path):
    regions = {"Body": cylinder(20.0), "Iso": [np.zeros((1, 3))]}
    path = write_contours(tmp_path / "rt.dcm", regions, {"Iso": "POINT"})
    assert [one.name for one in read_labels(path).segments] == ["Body"]
    assert "Iso" in refused(path, ("Iso",)).what
    write_contours(path, {"Body": cylinder(20.0)}, {"Body": "OPEN_PLANAR"})
    assert "0 segments" in refused(path).what
    data = write_contours(tmp_path / "rt.dcm", {"Body": cylinder(20.0)}).read_bytes()
    (tmp_path / "cut.dcm").write_bytes(data[: len(data) // 2])
    refused(tmp_path / "cut.dcm")


@pytest.mark.parametrize(
    ("contours", "word"),
    [
        ([circle(9.0, 0.0)], "one plane"),
        ([circle(9.0, z) for z in (0.0, 1.0, 2.4, 3.4)], "uneven"),
        ([circle(9.0, 0.0), circle(9.0, 1.0) @ turned_about([1, 0, 0], 0.3)], "flat"),
        ([circle(9.0, 0.0, count=2), circle(9.0, 1.0)], "three points"),
        ([circle(9.0, 0.0), circle(1e6, 1.0)], "finite"),
    ],
)
def test_contours_that_bound_nothing_are_refused(tmp_path, contours, word):
    assert word in refused(write_contours(tmp_path / "rt.dcm", {"Body": contours})).what
