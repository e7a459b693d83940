"""Candidates for a next insertion as its answer ranks them: by their ways in, the best, beside the repeat."""

import numpy as np
import pandas as pd

from needlefit.reporting.tables import Row, records
from needlefit.validation.analyses.runner import AnalysisResult

_KEY = ["role", "entry", "angle_deg", "depth_mm"]


def best(answer: AnalysisResult) -> Row | None:
    """Return the candidate that tells most; None if none has a solution."""
    ranked = [row for rows in ways(answer).values() for row in rows]
    return max(ranked, key=lambda row: float(row["nats"]), default=None)


def repeat(answer: AnalysisResult) -> Row | None:
    """Return the deepest insertion made so far, once more; None if it has no solution."""
    every = answer.frames["candidates"]
    found = records(every[(every["role"] == "repeat") & every["nats"].notna()])
    return found[0] if found else None


def ways(answer: AnalysisResult) -> dict[tuple[str, float], list[Row]]:
    """Return the candidates that have a solution, by entry and angle."""
    every = answer.frames["candidates"]
    found: dict[tuple[str, float], list[Row]] = {}
    for row in records(every[(every["role"] == "candidate") & every["nats"].notna()]):
        found.setdefault((str(row["entry"]), float(row["angle_deg"])), []).append(row)
    return found


def about(frame: pd.DataFrame, where: Row) -> pd.DataFrame:
    """Return the rows about one candidate."""
    same = np.all([frame[key] == where[key] for key in _KEY], axis=0)
    return frame[same]
