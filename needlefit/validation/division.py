"""What tunes and what validates: how many insertions, how deep they go, how far they bend."""

from collections.abc import Iterator

import pandas as pd

from needlefit.datasets.insertion import Insertion
from needlefit.datasets.select import layers_of, other_reading
from needlefit.project.records.fit import Reading
from needlefit.validation.job import Job
from needlefit.validation.results import COLUMNS
from needlefit.validation.score import Row

Group = tuple[str, str, int]


def division(job: Job) -> pd.DataFrame:
    """Return a row per role, medium and layers; folds share their insertions.

    `insertions_other` is how many of the same insertions the other reading counts there; a group that only
    the other reading has is left out of the first count.
    """
    ours, others = (_groups(job, r) for r in (job.record.reading, other_reading(job.record.reading)))
    rows = [_row(group, ours.get(group, {}), others.get(group, {})) for group in {**ours, **others}]
    return pd.DataFrame(rows, columns=list(COLUMNS["design"])).sort_values(
        ["role", "medium", "layers"], ascending=[True, True, False], ignore_index=True
    )


def _groups(job: Job, reading: Reading) -> dict[Group, dict[str, Insertion]]:
    found: dict[Group, dict[str, Insertion]] = {}
    for role, insertion in _used(job):
        group = (role, insertion.medium, layers_of(insertion, reading))
        found.setdefault(group, {})[insertion.id] = insertion
    return found


def _used(job: Job) -> Iterator[tuple[str, Insertion]]:
    for fold in job.folds:
        yield from (("tune", insertion) for insertion in fold.tune)
        yield from (("validate", insertion) for insertion in fold.validate)


def _row(group: Group, ours: dict[str, Insertion], others: dict[str, Insertion]) -> Row:
    members = (ours or others).values()
    depths, bends = [one.depth for one in members], [one.deflection for one in members]
    return {
        **dict(zip(("role", "medium", "layers"), group, strict=True)),
        "insertions": len(ours),
        "insertions_other": len(others),
        "depth_min_mm": min(depths),
        "depth_max_mm": max(depths),
        "deflection_min_mm": min(bends),
        "deflection_max_mm": max(bends),
    }
