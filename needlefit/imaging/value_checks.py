"""Refuse volumes whose values cannot be Hounsfield units (HU)."""

import numpy as np

from needlefit.errors import DataError
from needlefit.imaging.volume import Volume

MIN_RANGE_HU = 100.0
"""Air, tissue and metal differ by more, HU; attenuation per length never does."""

STORED_AIR, STORED_WATER = 0.0, 1024.0
"""What air and water read where a CT was saved without its rescale."""

RESCALE_FIX = (
    "export the scan in HU (water 0, air -1000), e.g. as DICOM with its rescale, or convert the values: "
    "HU = 1000 (mu / mu of water - 1)"
)


def require_hounsfield(volume: Volume, where: str) -> None:
    """Refuse values that cannot be HU: files without a modality hold MR, stored or attenuation values, too.

    HU have a fixed zero: what lies around any needle has values below it, be it air, or the noise of water.

    Raises
    ------
    DataError
    """
    low, high = float(volume.values.min()), float(volume.values.max())
    if low < 0 and high - low >= MIN_RANGE_HU:
        return
    raise DataError(
        f"its values are no Hounsfield units: they lie between {low:.4g} and {high:.4g}, "
        + _guess(volume, high),
        where=where,
        expected="a CT volume in HU",
        fix=RESCALE_FIX,
    )


def _guess(volume: Volume, high: float) -> str:
    """Return what the values may be, in words."""
    if high < MIN_RANGE_HU:
        return "as attenuation per length does (micro-CT)"
    some = volume.values[::3, ::3, ::3]
    dense = some[some > STORED_WATER / 2]
    water = float(np.median(dense)) if dense.size else 0.0
    if abs(water - STORED_WATER) < STORED_WATER / 4:
        return f"with {water:.0f} as the commonest above air: stored values, perhaps, without their rescale"
    return "as those of MR, ultrasound or unscaled micro-CT do"
