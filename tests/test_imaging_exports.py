"""Scans as image archives export them: folders in folders, ZIP."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from dicom_series import NUMBERS, a_slice, save, series
from pydicom.uid import generate_uid
from reading_here import child_process_reader, read_here  # noqa: F401
from scanner.write import write_volume
from test_imaging_volume_dicom import refused

from needlefit.imaging.volume import Volume
from needlefit.imaging.volume_files import read_volume

pytestmark = pytest.mark.usefixtures("read_here")
OTHER = generate_uid(entropy_srcs=["other"])


def pack(path, files):
    """Write an archive of files, (name, bytes)."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files:
            archive.writestr(name, data)
    return path


@pytest.mark.parametrize("modality", ["CT", "MR"])
def test_the_series_of_an_export_are_listed_with_their_folders(tmp_path, modality):
    slices, known = series(), {"SeriesInstanceUID": OTHER, "SeriesNumber": 4, "Modality": modality}
    save(tmp_path / "DICOM" / "SE1", slices[:4])
    save(tmp_path / "DICOM" / "SE1b", slices[4:])
    save(tmp_path / "DICOM" / "SE2", [a_slice(k, NUMBERS[k] + 1, **known) for k in range(3)])
    (tmp_path / "viewer.exe").write_bytes(b"MZ" * 100)
    assert np.array_equal(read_volume(tmp_path, "3").values, NUMBERS)
    if modality == "CT":
        fault = refused(tmp_path)
        assert "holds 2 series" in fault.what and "DICOM/SE2/" in fault.what and "--series" in fault.fix
        assert "'needle' (CT, 6 images)" in fault.what and OTHER in fault.what
        named = (read_volume(tmp_path, place) for place in ("4", OTHER))
        for volume in (*named, read_volume(tmp_path / "DICOM" / "SE2" / "001.dcm")):
            assert np.array_equal(volume.values, NUMBERS[:3] + 1)
        assert "number 4" in refused(tmp_path, series="5").what
    else:
        assert np.array_equal(read_volume(tmp_path).values, NUMBERS)
        assert "Modality is MR" in refused(tmp_path, series="4").what


def test_archives_of_series_and_of_image_files(tmp_path):
    dicom = [(one.name, one.read_bytes()) for one in save(tmp_path / "series", series()).iterdir()]
    inner = pack(tmp_path / "inner.zip", dicom)
    assert np.array_equal(read_volume(inner).values, NUMBERS)
    write_volume(Volume(NUMBERS.astype(np.float32), np.zeros(3), np.ones(3), np.eye(3)), tmp_path / "a.nrrd")
    image = ("x/a.nrrd", (tmp_path / "a.nrrd").read_bytes())
    path = pack(tmp_path / "one.zip", [image, ("__MACOSX/._a.nrrd", b"x")])
    assert np.array_equal(read_volume(path).values, NUMBERS)
    both = pack(tmp_path / "both.zip", [image, *dicom])
    assert np.array_equal(read_volume(both, "3").values, NUMBERS)
    assert "7 files" in refused(both).what
    for name, files, words in (
        ("two.zip", [image, ("b.nrrd", image[1])], "b.nrrd"),
        ("outer.zip", [("a/inner.zip", inner.read_bytes())], "no series"),
        ("empty.zip", [], "no series"),
    ):
        assert words in refused(pack(tmp_path / name, files)).what


@pytest.mark.parametrize("name", ["../x.dcm", "/etc/x.dcm", "a/../../x.dcm", "C:\\x.dcm", "a\x1b.dcm"])
def test_an_archive_that_names_files_outside_writes_none_there(tmp_path, name):
    refused(pack(tmp_path / "a.zip", [(name, b"x")]))
    assert not (tmp_path.parent / "x.dcm").exists() and not Path("/etc/x.dcm").exists()


def test_damaged_encrypted_and_bloated_archives_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "a.zip"
    path.write_bytes(b"")
    assert "BadZipFile" in refused(path).what
    data = bytearray(pack(path, [("a.dcm", bytes(1000))]).read_bytes())
    for mark, place in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(mark) + place] |= 1
    path.write_bytes(data)
    assert "encrypted" in refused(path).what
    bomb = pack(path, [(f"{n}.dcm", bytes(2**20)) for n in range(3)])
    assert "unpacks" not in refused(bomb).what
    monkeypatch.setenv("NEEDLEFIT_READ_GIB", "0.002")
    assert "unpacks" in refused(bomb).what
