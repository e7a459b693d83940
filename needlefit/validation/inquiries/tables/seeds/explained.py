"""Why the fit loses a contest, where the data support a reason; else the loss is said to be unexplained.

A reason is given only with the numbers that bear it out, computed from the very runs:

- *the truth* knows needle, moduli, friction and bevel, of which a fit knows nothing;
- *another medium*: the rival errs more than the fit on the insertions that were tuned on, and less on a
  medium that bends less than the fit foretells, because the rival foretells less bending everywhere: no merit
  of what it knows;
- *its moduli*: those of the rival are not fitted, and nearer to the twin's own than the fitted ones;
- *too small to matter*: the difference is under a tenth of the noise floor.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from needlefit.validation.inquiries.tables.seeds.one_twin import TRUTH
from needlefit.validation.score import Row

SMALL = 0.1
"""Part of the noise floor under which a difference of means matters to nobody."""

UNEXPLAINED = "not explained"


@dataclass(frozen=True)
class _Known:
    """What reasons are sought in."""

    errors: pd.DataFrame
    parameters: pd.DataFrame


def explained(contests: pd.DataFrame, errors: pd.DataFrame, parameters: pd.DataFrame) -> pd.DataFrame:
    """Return the contests with an `explanation` of every one that the fit loses; else it is empty."""
    known = _Known(errors, parameters)
    rows = contests.to_dict("records")
    why = [_why(row, known) if row["verdict"] == "loses" else "" for row in rows]  # type: ignore[arg-type]
    return contests.assign(explanation=why)


def _why(row: Row, known: _Known) -> str:
    reasons = [reason(row, known) for reason in _REASONS]
    return next((reason for reason in reasons if reason), UNEXPLAINED)


def _truth(row: Row, known: _Known) -> str:
    if row["rival"] != TRUTH:
        return ""
    return "it is the needle as it really is: its own moduli, rigidity, friction and bevel"


def _other_medium(row: Row, known: _Known) -> str:
    errors = known.errors[known.errors["study"] == row["study"]]
    tuned = errors[errors["role"] == "tune"]
    if row["medium"] in set(tuned["medium"]):
        return ""
    in_sample = {rival: _mean(tuned, rival, row["metric"]) for rival in ("fitted", row["rival"])}
    held_out = errors[errors["role"] == "validate"]
    foretold = {rival: _mean(held_out, rival, "predicted_deflection_mm") for rival in in_sample}
    true = _mean(held_out, "fitted", "deflection_mm")
    ours, theirs = in_sample["fitted"], in_sample[row["rival"]]
    if not (theirs > ours and foretold["fitted"] > max(true, foretold[row["rival"]])):
        return ""
    return (
        f"another medium, which bends by {true:.2f} mm: the fit foretells {foretold['fitted']:.2f}, the "
        f"rival {foretold[row['rival']]:.2f}; it errs more than the fit on what was tuned on "
        f"({theirs:.2f} against {ours:.2f} mm)"
    )


def _moduli(row: Row, known: _Known) -> str:
    if row["rival"] != "hand_tuned_b":
        return ""
    wanted = (known.parameters["study"] == row["study"]) & known.parameters["parameter"].str.startswith("mu")
    mu = known.parameters[wanted]
    ours, theirs = (float(np.exp(np.abs(np.log(mu[c] / mu["true"])).mean())) for c in ("value", "paper"))
    if not theirs < ours:
        return ""
    return (
        f"its moduli are not fitted, and nearer to the twin’s own than the fitted ones (off by a factor of "
        f"{theirs:.2f} against {ours:.2f}): b alone is left to learn"
    )


def _small(row: Row, known: _Known) -> str:
    if not row["difference_mm"] < SMALL * row["floor_mm"]:
        return ""
    return f"under a tenth of the noise floor of {row['floor_mm']:.2f} mm"


_REASONS: tuple[Callable[[Row, _Known], str], ...] = (_truth, _other_medium, _moduli, _small)


def _mean(errors: pd.DataFrame, rival: str, metric: str) -> float:
    values = errors.loc[errors["rival"] == rival, metric].astype(float)
    return float(values.replace([np.inf], np.nan).mean())
