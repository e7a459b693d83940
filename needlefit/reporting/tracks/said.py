"""What a study of tip tracks came to, in sentences."""

import pandas as pd

from needlefit.reporting.names import medium_name
from needlefit.reporting.tables import records
from needlefit.reporting.tracks.layouts import NAMES, SHOWN
from needlefit.validation.tracks.results import TrackResults, compare_methods_by_run

_WORDS = {"rms_mm": "foretold", "aligned_rms_mm": "in shape"}


def cautions(results: TrackResults) -> tuple[str, ...]:
    """Return what must be known before the numbers: what has not converged, which runs are missing."""
    return (*(f"NOT CONVERGED: {fault}." for fault in results.faults), *results.remarks)


def in_short(results: TrackResults) -> tuple[str, ...]:
    """Return a sentence per medium: against which rivals the fit stands how."""
    paired = compare_methods_by_run(results)
    return tuple(_verdict(str(medium), group) for medium, group in paired.groupby("medium", sort=False))


def _verdict(medium: str, group: pd.DataFrame) -> str:
    parts = [f"{_WORDS[one]}, {_against(group[group['measure'] == one])}" for one in SHOWN]
    return f"{medium_name(medium)}: {'; '.join(parts)}."


def _against(group: pd.DataFrame) -> str:
    """Return how the fit stands against each method: better or worse where the interval says so."""
    stands: dict[str, list[str]] = {}
    for row in records(group[group["method"] != "fitted"]):
        low, high = row["difference_low_mm"], row["difference_high_mm"]
        word = "better than" if low > 0 else "worse than" if high < 0 else "not told apart from"
        stands.setdefault(word, []).append(f"the {NAMES[str(row['method'])]}")
    return "the fit is " + ", ".join(f"{word} {' and '.join(names)}" for word, names in stands.items())
