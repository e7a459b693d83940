"""Files that crash native readers, fill the memory or point elsewhere; and those that only look unusual."""

import resource
import shutil
import time
from pathlib import Path

import pytest
from refusals import refusal

from needlefit.datasets.formats.mat import read_curves
from needlefit.errors import DataError
from needlefit.imaging.segmentations import read_labels
from needlefit.imaging.volume_files import read_volume

CORPUS = sorted((Path(__file__).parent / "fuzz" / "corpus").iterdir())
MAX_SECONDS, MAX_KIB = 10, 2**20


def reader(path):
    return read_curves if path.suffix == ".mat" else read_labels if ".seg." in path.name else read_volume


def peak_kib() -> int:
    """Return the most memory that any child of this process has used, those of other tests among them."""
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss


@pytest.fixture
def peak_before() -> int:
    return peak_kib()


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.name)
def test_a_file_that_crashed_a_reader_is_a_data_error(path, tmp_path, peak_before):
    begin = time.monotonic()
    found = refusal(DataError, "", lambda: reader(path)(Path(shutil.copy(path, tmp_path))))
    assert str(tmp_path) in found.where and found.what and found.fix
    assert time.monotonic() - begin < MAX_SECONDS
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # a child begins with the memory of this process
    assert peak_kib() <= max(peak_before, MAX_KIB, own)
