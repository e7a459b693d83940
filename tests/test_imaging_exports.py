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


def pack(path, files, method=zipfile.ZIP_DEFLATED):
    """Write an archive of a folder, or of (name, bytes)."""
    if not isinstance(files, list):
        files = [(str(one.relative_to(files)), one.read_bytes()) for one in files.rglob("*") if one.is_file()]
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in files:
            archive.writestr(name, data)
    return path


def export(folder, **entries):
    """A CT in two folders, a second series, a report viewer."""
    slices = series()
    save(folder / "DICOM" / "ST1" / "SE1", slices[:4])
    save(folder / "DICOM" / "ST1" / "SE1b", slices[4:])
    known = {"SeriesInstanceUID": OTHER, "SeriesNumber": 4, "Modality": "CT"} | entries
    save(folder / "DICOM" / "ST1" / "SE2", [a_slice(k, NUMBERS[k] + 1, **known) for k in range(3)])
    (folder / "VIEWER").mkdir()
    (folder / "VIEWER" / "viewer.exe").write_bytes(b"MZ" * 100)
    return folder


# ---- folders in folders


def test_the_series_of_an_export_are_listed_with_their_folders(tmp_path):
    fault = refused(export(tmp_path))
    assert "holds 2 series" in fault.what and "DICOM/ST1/SE2/" in fault.what and "--series" in fault.fix
    assert np.array_equal(read_volume(tmp_path, "3").values, NUMBERS)
    assert np.array_equal(read_volume(tmp_path, OTHER).values, NUMBERS[:3] + 1)
    (tmp_path := tmp_path / "b").mkdir()
    assert np.array_equal(read_volume(export(tmp_path, Modality="MR")).values, NUMBERS)
    fault = refused(tmp_path, series="4")
    assert "Modality is MR" in fault.what and "HU" in fault.expected


def test_values_that_are_no_hu_are_refused_and_an_unspecified_unit_gives_a_warning(tmp_path):
    for unit in ["OD", "MGML", "MG HA/CCM"]:
        fault = refused(save(tmp_path, series(RescaleType=unit)))
        assert f"RescaleType is {unit}" in fault.what and "micro-CT" in fault.fix
    (warning,) = read_volume(save(tmp_path, series(RescaleType="US"))).warnings
    assert "RescaleType" in warning


# ---- archives


def test_archives_of_series_and_of_image_files(tmp_path):
    inner = pack(tmp_path / "inner.zip", save(tmp_path / "series", series()))
    assert np.array_equal(read_volume(inner).values, NUMBERS)
    outer = pack(tmp_path / "outer.zip", [("a/inner.zip", inner.read_bytes())])
    assert "no series" in refused(outer).what
    (tmp_path := tmp_path / "b").mkdir()
    volume = Volume(NUMBERS.astype(np.float32), np.zeros(3), np.ones(3), np.eye(3))
    write_volume(volume, tmp_path / "a.nrrd")
    data = (tmp_path / "a.nrrd").read_bytes()
    path = pack(tmp_path / "one.zip", [("x/a.nrrd", data), ("__MACOSX/._a.nrrd", b"x")])
    assert np.array_equal(read_volume(path).values, NUMBERS)
    path = pack(tmp_path / "two.zip", [("x/a.nrrd", data), ("b.nrrd", data)])
    assert "b.nrrd" in refused(path).what
    dicom = save(tmp_path / "series", series())
    files = [("a.nrrd", data), *((one.name, one.read_bytes()) for one in dicom.iterdir())]
    path = pack(tmp_path / "both.zip", files)
    assert "7 files" in refused(path).what and np.array_equal(read_volume(path, "3").values, NUMBERS)


@pytest.mark.parametrize("name", ["../x.dcm", "/etc/x.dcm", "a/../../x.dcm", "C:\\x.dcm", "a\x1b.dcm"])
def test_an_archive_that_names_files_outside_writes_none_there(tmp_path, name):
    refused(pack(tmp_path / "a.zip", [(name, b"x")]))
    assert not (tmp_path.parent / "x.dcm").exists() and not Path("/etc/x.dcm").exists()


def damaged(path, change):
    data = bytearray(path.read_bytes())
    change(data)
    path.write_bytes(data)
    return path


def test_damaged_encrypted_and_bloated_archives_are_refused(tmp_path, monkeypatch):
    def encrypt(data):
        for mark, place in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
            data[data.index(mark) + place] |= 1

    files = [("a.dcm", bytes(1000))]
    assert "BadZipFile" in refused(damaged(pack(tmp_path / "a.zip", files), lambda data: data.clear())).what
    assert "encrypted" in refused(damaged(pack(tmp_path / "b.zip", files), encrypt)).what
    assert "no series" in refused(pack(tmp_path / "e.zip", [])).what
    bomb = pack(tmp_path / "a.zip", [(f"{n}.dcm", bytes(2**20)) for n in range(3)])
    assert "unpacks" not in refused(bomb).what
    monkeypatch.setenv("NEEDLEFIT_READ_GIB", "0.002")
    assert "unpacks" in refused(bomb).what
