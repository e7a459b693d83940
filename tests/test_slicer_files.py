"""Files that 3D Slicer wrote itself, which `slicerio` ships: read as that library reads them, or refused."""

from pathlib import Path

import numpy as np
import pytest
import slicerio

from needlefit.datasets.formats.fcsv import read_fcsv
from needlefit.errors import DataError
from needlefit.imaging.layers import extract_label_surfaces, read_labels
from needlefit.imaging.volume import to_patient
from needlefit.imaging.volume_files import read_volume

FILES = Path(slicerio.__file__).parent / "data"


def test_a_chest_ct():
    import nrrd

    values, header = nrrd.read(str(FILES / "CTChest4.nrrd"))
    volume = read_volume(FILES / "CTChest4.nrrd")
    assert np.array_equal(volume.values, values.T)
    last = header["space origin"] + (np.array(values.shape) - 1) @ header["space directions"]
    corners = to_patient(volume, [[0, 0, 0], np.array(values.shape) - 1])
    assert header["space"] == "left-posterior-superior"
    assert corners == pytest.approx(np.array([header["space origin"], last]))


def test_a_segmentation():
    path = FILES / "Segmentation.seg.nrrd"
    expected = slicerio.read_segmentation(str(path))
    labels = read_labels(path)
    assert [(one.name, one.value) for one in labels.segments] == [
        (one["name"], one["labelValue"]) for one in expected["segments"]
    ]
    assert np.array_equal(labels.volume.values, expected["voxels"].T)
    matrix = np.asarray(expected["ijkToLPS"])
    ijk = [[0, 0, 0], [3, 5, 7]]
    assert to_patient(labels.volume, ijk) == pytest.approx(ijk @ matrix[:3, :3].T + matrix[:3, 3])
    with pytest.raises(DataError) as error:
        read_labels(FILES / "SegmentationOverlapping.seg.nrrd")
    assert "overlap" in error.value.what and "Segment Editor" in error.value.fix


@pytest.mark.sweep
def test_segments_of_it_as_layers():
    path = FILES / "Segmentation.seg.nrrd"
    names = [one.name for one in read_labels(path).segments]
    (one,) = extract_label_surfaces(path, names[-1:])
    assert one.into == 1 and one.mesh.is_watertight


def test_points():
    (expected,) = slicerio.read_markups_fcsv(str(FILES / "F_1.fcsv"))["markups"]
    found = read_fcsv(FILES / "F_1.fcsv")
    assert expected["coordinateSystem"] == found.system == "LPS"
    assert list(found.labels) == [one["label"] for one in expected["controlPoints"]]
    assert found.points == pytest.approx(np.array([one["position"] for one in expected["controlPoints"]]))
