"""Values that are no Hounsfield units are refused, with what they may be."""

from dataclasses import replace

import ct_cases as cases
import numpy as np
import pytest

from needlefit.errors import DataError
from needlefit.imaging.volume import require_hounsfield


@pytest.fixture(scope="module")
def volume():
    return cases.scan(cases.axis())


def test_a_ct_in_hu_is_taken(volume):
    require_hounsfield(volume, "scan.nrrd")


@pytest.mark.parametrize(
    ("convert", "words"),
    [
        (lambda hu: np.clip(hu + 1024, 0, 4095), "stored"),
        (lambda hu: np.clip(hu + 1000, 0, None) * 2e-4, "micro-CT"),
        (lambda hu: (np.clip(hu + 1000, 0, None) * 2e-4) - 0.01, "micro-CT"),  # noise below 0
        (lambda hu: np.abs(hu + 1000) / 3, "MR"),
    ],
)
def test_other_values_are_refused(volume, convert, words):
    other = replace(volume, values=convert(volume.values.astype(np.float64)).astype(np.float32))
    with pytest.raises(DataError) as refused:
        require_hounsfield(other, "scan.nrrd")
    assert refused.value.where == "scan.nrrd"
    assert words in refused.value.what
    assert refused.value.fix
