"""Every candidate against the reference: summed differences of log densities, and who wins."""

import math
from collections.abc import Iterator

import numpy as np
import pandas as pd

from needlefit.inference.ties import NOISE_SCALE
from needlefit.inference.weighing.pareto import RELIABLE
from needlefit.project.records.comparison import ComparisonRecord
from needlefit.validation.inquiries.answered import Frames
from needlefit.validation.score import Row

SURE = 2.0
"""Standard errors from which on a difference is taken for one."""

AHEAD, BEHIND, TIE, REFERENCE = "ahead", "behind", "tie", "reference"


def conclude(record: ComparisonRecord, frames: Frames) -> tuple[str, ...]:
    """Add `differences` by needles, `contest` by groups and `against` by candidates; return the faults."""
    scores = frames["scores"].astype({"log_density": float, "te_mm": float, "ipe_mean_mm": float})
    frames["differences"] = _differences(scores, record.reference)
    rows = list(_against(record, frames["differences"], scores, frames["fits"]))
    frames["against"] = pd.DataFrame(rows)
    frames["contest"] = pd.DataFrame(list(_contest(frames["differences"], rows)))
    return (*_faults(frames), *(_control(record, rows) if record.must_win else ()))


def _differences(scores: pd.DataFrame, reference: str) -> pd.DataFrame:
    """Return every candidate's log density of each needle, less the reference's."""
    theirs = scores[scores["candidate"] == reference].set_index("insertion")["log_density"]
    found = scores[["candidate", "fold", "insertion", "group", "points"]].copy()
    with np.errstate(invalid="ignore"):
        found["difference"] = scores["log_density"] - scores["insertion"].map(theirs)
    return found


def summed(differences: pd.Series, groups: pd.Series) -> tuple[float, float, int]:
    """Return the sum of differences, its standard error over groups, and how many groups there are."""
    by = differences.groupby(groups, sort=False).sum()
    error = np.sqrt(len(by)) * by.std(ddof=1) if len(by) > 1 else np.nan
    return float(by.sum()), float(error), len(by)


def drawn_error(scores: pd.DataFrame) -> float:
    """Return the Monte Carlo error of the sum of one candidate's log densities.

    What the needles of a fold share is the same error in all of them: it adds up, and does not average out.
    """
    whole, shared = (scores[key].astype(float) for key in ("log_density_se", "shared_se"))
    folds = shared.groupby(scores["fold"]).sum()
    return float(np.sqrt((whole**2 - shared**2).sum() + (folds**2).sum()))


def verdict(difference: float, error: float) -> str:
    """Return whether a candidate stands ahead of the reference, behind it, or cannot be told apart."""
    if not abs(difference) > SURE * error:
        return TIE
    return AHEAD if difference > 0 else BEHIND


def _against(
    record: ComparisonRecord, differences: pd.DataFrame, scores: pd.DataFrame, fits: pd.DataFrame
) -> Iterator[Row]:
    """Yield one row for each candidate; what draws leave open adds to the scatter between groups."""
    reference = drawn_error(scores[scores["candidate"] == record.reference])
    for name in record.candidates:
        own, scored = differences[differences["candidate"] == name], scores[scores["candidate"] == name]
        fitted = fits[fits["candidate"] == name]
        difference, scatter, count = summed(own["difference"], own["group"])
        drawn = drawn_error(scored)
        error = math.hypot(scatter, drawn, reference) if name != record.reference else 0.0
        scale = fitted.loc[fitted["parameter"] == NOISE_SCALE, "value"].astype(float)
        yield {
            "candidate": name,
            "insertions": len(own),
            "groups": count,
            "log_density": float(scored["log_density"].sum()),
            "difference": difference,
            "difference_se": error,
            "verdict": REFERENCE if name == record.reference else verdict(difference, error),
            "draws_se": drawn,
            "ipe_mean_mm": float(scored["ipe_mean_mm"].mean()),
            "te_mm": float(scored["te_mm"].mean()),
            "floor_ipe_mean_mm": float(scored["floor_ipe_mean_mm"].astype(float).mean()),
            "floor_te_mm": float(scored["floor_te_mm"].astype(float).mean()),
            "noise_scale": float(np.exp(np.log(scale).mean())),
            "worst_pareto_k": float(scored["pareto_k"].astype(float).max()),
            "fewest_independent_draws": float(scored["independent_draws"].astype(float).min()),
        }


def _contest(differences: pd.DataFrame, rows: list[Row]) -> Iterator[Row]:
    """Yield the differences of every group, and their mean with two standard errors, as "mean"."""
    for row in rows:
        if row["verdict"] == REFERENCE:
            continue
        own = differences[differences["candidate"] == row["candidate"]]
        each = own.groupby("group", sort=False)["difference"].sum()
        for group, value in each.items():
            yield {"candidate": row["candidate"], "group": group, "difference": value}
        mean, error = (row[key] / row["groups"] for key in ("difference", "difference_se"))
        ends = {"low": mean - SURE * error, "high": mean + SURE * error}
        yield {
            "candidate": row["candidate"],
            "group": "mean",
            "difference": mean,
            **ends,
            "verdict": row["verdict"],
        }


def _faults(frames: Frames) -> tuple[str, ...]:
    scores = frames["scores"]
    failed = int((~scores["converged"].astype(bool)).sum())
    nowhere = int((~np.isfinite(scores["log_density"].astype(float))).sum())
    doubtful = int((scores["pareto_k"].astype(float) > RELIABLE).sum())
    return (
        *((f"{failed} simulations of held-out insertions did not converge",) if failed else ()),
        *((f"{nowhere} held-out insertions have no density",) if nowhere else ()),
        *((f"{doubtful} log densities are not certified: Pareto k above {RELIABLE}",) if doubtful else ()),
    )


def _control(record: ComparisonRecord, rows: list[Row]) -> Iterator[str]:
    """Say where a comparison misses a difference that was put in: then it could not tell one elsewhere."""
    missed = [row["candidate"] for row in rows if row["verdict"] in (TIE, AHEAD)]
    if missed:
        yield (
            f"{record.reference} made these data and is not found ahead of {', '.join(missed)}: this "
            "comparison could not tell them apart elsewhere either"
        )
