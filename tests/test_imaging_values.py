"""Values that are no Hounsfield units are refused, with what they may be."""

from dataclasses import replace

import ct_cases as cases
import numpy as np
import pytest

from needlefit.errors import DataError
from needlefit.imaging.volume import require_hounsfield


@pytest.mark.parametrize(
    ("convert", "words"),
    [
        (lambda hu: np.clip(hu + 1024, 0, 4095), "stored"),
        (lambda hu: np.clip(hu + 1000, 0, None) * 2e-4, "micro-CT"),
        (lambda hu: (np.clip(hu + 1000, 0, None) * 2e-4) - 0.01, "micro-CT"),  # noise below 0
        (lambda hu: np.abs(hu + 1000) / 3, "MR"),
    ],
)
def test_values_that_are_no_hu_are_refused(convert, words):
    volume = cases.scan(cases.axis())
    require_hounsfield(volume, "scan.nrrd")
    other = replace(volume, values=convert(volume.values.astype(np.float64)).astype(np.float32))
    with pytest.raises(DataError, match=words) as refused:
        require_hounsfield(other, "scan.nrrd")
    assert refused.value.where == "scan.nrrd" and refused.value.fix
