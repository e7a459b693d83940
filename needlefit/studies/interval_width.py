"""The width of the 95 % interval of a predicted tip, also after one insertion; warn where it is too wide."""

from collections.abc import Iterator

import numpy as np

from needlefit.arrays import Floats
from needlefit.project.input_files import read_toml
from needlefit.project.locate import find_file, list_names
from needlefit.project.result_warnings import ResultWarning
from needlefit.reporting.text import KindText

#: width of the 95 % interval of a tip up to which it serves for aiming, whatever the deflection
MAX_AIMING_WIDTH_MM = 2.0


def measure_width(tips: Floats) -> float:
    """Return how wide the central 95 % of tips (B,) are, mm; NaN are left out."""
    low, high = np.nanquantile(tips, [0.025, 0.975])
    return float(high - low)


def estimate_width_after_one(tips: Floats, known: Floats) -> float:
    """Return how wide the central 95 % of tips are once the tip of another insertion is measured, mm.

    Parameters
    ----------
    tips : (B,) array
        Of an insertion, one for each draw of the parameters, mm; NaN where there is none.
    known : (B,) array
        Measured tips of another insertion into the same specimen with the same parameters, mm. What tips
        share with them is subtracted, linear in them.
    """
    solved = np.isfinite(tips) & np.isfinite(known)
    (variance, shared), _ = np.cov(known[solved], tips[solved])
    return measure_width(tips - shared / variance * known)


def warn_if_too_wide(
    width_mm: float, deflection_mm: float, where: str = "", fix: str = ""
) -> Iterator[ResultWarning]:
    """Yield a warning if an interval is wider than the tip is deflected, and than `MAX_AIMING_WIDTH_MM`.

    Parameters
    ----------
    where : str
        The medium of the tips whose median width and deflection are given; empty: of a single tip.
    fix : str
        What narrows the interval; by default more data.
    """
    if is_too_wide(width_mm, deflection_mm):
        values = {"group": where, "width_mm": width_mm, "deflection_mm": deflection_mm, "gain": fix}
        text = KindText("warnings")
        what, remedy = (text.sentence(block, values) for block in ("wide_intervals", "wide_intervals_fix"))
        yield ResultWarning("wide_intervals", what, fix=remedy)


def is_too_wide(width_mm: float, deflection_mm: float) -> bool:
    """Return whether an interval is wider than the tip is deflected, and than `MAX_AIMING_WIDTH_MM`."""
    return width_mm > max(MAX_AIMING_WIDTH_MM, deflection_mm)


def find_adaptation(dataset: str, fitted: str, new: str | None = None) -> str:
    """Return the name of a study that adds insertions of another medium to a fit on a dataset; "" if none.

    `fitted` and `new` are the media; without `new` any will do.
    """
    for name in list_names("study"):
        found = read_toml(find_file("study", name))
        if found.get("kind") == "adaptation" and found.get("dataset") == dataset:
            media = found.get("old", {}).get("medium"), found.get("new", {}).get("medium")
            if media[0] == fitted and new in (None, media[1]):
                return name
    return ""
