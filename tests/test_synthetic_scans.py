"""The twin as scans: what is true stands in the volumes at its stated position."""

from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose
from scanner import twin
from synthetic.insertion import TWIN_SEED

from needlefit.imaging.volume_files import read_volume
from needlefit.project.locate import shipped_folder
from needlefit.project.tasks import THIS_PROCESS

SHIPPED = shipped_folder() / "data" / "sample_scan"


def quiet(_what, _done, _of):
    """Report nothing."""


# ---- pose, seed, files


def files(folder):
    return sorted(path for path in Path(folder).rglob("*") if path.is_file())


def test_the_shipped_sample_is_a_rebuild(tmp_path):
    """On the machine that built it to the last byte; elsewhere rounding may turn a voxel by 1 HU."""
    twin.write_scans(tmp_path, [twin.SAMPLE_INSERTION], TWIN_SEED, THIS_PROCESS, quiet)
    ours = [path.relative_to(SHIPPED) for path in files(SHIPPED) if path.name != "needlefit.json"]
    assert ours == [path.relative_to(tmp_path) for path in files(tmp_path)]
    assert sum((SHIPPED / name).stat().st_size for name in ours) < 2_000_000
    for name in ours:
        if name.suffix == ".nrrd":
            a, b = read_volume(SHIPPED / name), read_volume(tmp_path / name)
            assert np.abs(a.values - b.values).max() <= 1 and np.mean(a.values != b.values) < 1e-4
            assert_allclose(a.origin, b.origin, atol=1e-9)
        else:
            assert (SHIPPED / name).read_bytes() == (tmp_path / name).read_bytes()
