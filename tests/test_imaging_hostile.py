"""Files that crash native readers, fill the memory or point elsewhere; and those that only look unusual."""

import bz2
import gzip
import resource
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from refusals import refusal
from test_imaging_volume import VALUES, metaimage, nifti, nrrd

from needlefit.datasets.formats.mat import read_curves
from needlefit.errors import DataError
from needlefit.imaging.segmentations import read_labels
from needlefit.imaging.volume import MAX_EXPANSION
from needlefit.imaging.volume_files import read_volume
from needlefit.project.reader_process import MEMORY_VARIABLE

CORPUS = sorted((Path(__file__).parent / "fuzz" / "corpus").iterdir())
MAX_SECONDS, MAX_KIB = 10, 2**20


def reader(path):
    return read_curves if path.suffix == ".mat" else read_labels if ".seg." in path.name else read_volume


def peak_kib() -> int:
    """Return the most memory that any child of this process has used, those of other tests among them."""
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss


def allowed_kib(peak_before: int) -> int:
    """Return what a reader may have used; a child begins with the memory of this process."""
    return max(peak_before, MAX_KIB, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


@pytest.fixture
def peak_before() -> int:
    return peak_kib()


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.name)
def test_a_file_that_crashed_a_reader_is_a_data_error(path, tmp_path, peak_before):
    begin = time.monotonic()
    found = refusal(DataError, "", lambda: reader(path)(Path(shutil.copy(path, tmp_path))))
    assert str(tmp_path) in found.where and found.what and found.fix
    assert time.monotonic() - begin < MAX_SECONDS
    assert peak_kib() <= allowed_kib(peak_before)


@pytest.mark.parametrize("name", ["mem-dicom-2480.dcm", "mem-dicom-3904.dcm"])
def test_a_slice_whose_element_claims_gigabytes(name, tmp_path, peak_before):
    """Two slices make a series, so that their voxels are read, too: one claims 2 GB in an element."""
    content = next(path for path in CORPUS if path.name == name).read_bytes()
    second = content.replace(rb"0.0\0.0\0.6 ", rb"0.0\0.0\1.2 ")
    assert second != content
    (tmp_path / "1.dcm").write_bytes(content)
    (tmp_path / "2.dcm").write_bytes(second)
    try:
        assert read_volume(tmp_path).values.shape == (2, 5, 6)
    except DataError as error:
        assert error.where.endswith(".dcm")
    assert peak_kib() <= allowed_kib(peak_before)


@pytest.mark.parametrize("name", ["a.nrrd", "a.mha", "a.nii.gz"])
def test_a_bomb_that_promises_what_it_unpacks_to(tmp_path, name):
    """1 MiB of deflated zeros stand for 1 GiB of voxels, 3 GiB in memory."""
    sizes, path = (1024, 1024, 512), tmp_path / name
    size = " ".join(map(str, sizes))
    packed = gzip.compress(bytes(2**20), 9) * 1024
    if name == "a.nrrd":
        nrrd(path, sizes=size, encoding="gzip", data=packed)
    elif name == "a.mha":
        metaimage(path, DimSize=size)
        path.write_bytes(b"CompressedData = True\n" + path.read_bytes() + packed)
    else:
        nifti(path, sizes=sizes)
        path.write_bytes(path.read_bytes() + packed)
    found = refusal(DataError, "", read_volume, path)
    assert MEMORY_VARIABLE in found.fix and f"{MAX_EXPANSION} times" in found.expected


# What is unusual, and right


def plain(path):
    assert np.array_equal(read_volume(path).values, VALUES)


def test_what_common_programs_leave_in_headers_is_read_or_named(tmp_path):
    packed = nrrd(tmp_path / "a.nrrd", encoding="bzip2", data=bz2.compress(VALUES.tobytes()))
    caught = refusal(DataError, "", read_volume, packed)
    assert "bzip2" in caught.what and caught.fix
    (tmp_path := tmp_path / "b").mkdir()
    # Comments, texts of any length, line ends of Windows, and what other programs leave in them.
    path = nrrd(tmp_path / "a.nrrd", content="a scan", kinds="domain domain domain")
    head, _, data = path.read_bytes().partition(b"\n\n")
    more = [b"# made by hand", b"Segmentation_Terminology:=" + b"~^" * 5000, b"note:=a: b, caf\xc3\xa9 \xff"]
    path.write_bytes(b"\n".join([head, *more]) + b"\n\n" + data)
    plain(path)
    path.write_bytes(b"\r\n".join(path.read_bytes()[: -len(data)].rstrip().split(b"\n")) + b"\r\n\r\n" + data)
    plain(path)
    path = metaimage(tmp_path / "a.mha")
    path.write_bytes(b"Comment = " + b"x" * 200 + b"\nModality = MET_MOD_CT\n" + path.read_bytes())
    plain(path)
    (tmp_path := tmp_path / "c").mkdir()
    # A segmentation of 1 MiB whose voxels are all alike packs 1000-fold.
    values = np.ones((64, 128, 128), np.uint8)
    path = nrrd(
        tmp_path / "a.nrrd", values, type="uint8", encoding="gzip", data=gzip.compress(values.tobytes())
    )
    assert path.stat().st_size < 5000
    assert read_volume(path).values.sum() == values.size
