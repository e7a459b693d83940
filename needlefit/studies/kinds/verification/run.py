"""Measure every check of the solver, and tabulate the rows and the refinement studies."""

import platform
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import pandas as pd

from needlefit.mechanics.control import ModelOptions
from needlefit.mechanics.laws import LAWS
from needlefit.registry import plugin_versions
from needlefit.studies.job import Settings
from needlefit.studies.kinds.verification.schema import VerificationRecord
from needlefit.studies.provenance import package_versions
from needlefit.studies.run import Run
from needlefit.verification.run import Verification, verify

_PACKAGES = ("numpy", "scipy")
_ROW_COLUMNS = (
    *("group", "check", "quantity", "measured", "bound_low", "bound_high", "unit", "verdict", "note"),
)
_REFINEMENT_COLUMNS = ("case", "norm", "h_mm", "error", "order")


def run(name: str, record: VerificationRecord, settings: Settings) -> Run:
    """Measure all checks; the tracebacks of those that crashed stand with the times."""
    found = verify(record.seed, progress=settings.progress)
    study = record.model_copy(update={"title": record.title or "Verification of the solver"})
    return Run(
        kind=record.kind,
        name=name,
        record=study,
        origin="none",
        dataset_title="no data",
        frames={
            "verification": pd.DataFrame(_tabulate_rows(found), columns=list(_ROW_COLUMNS)),
            "convergence": pd.DataFrame(_tabulate_refinements(found), columns=list(_REFINEMENT_COLUMNS)),
        },
        run={
            "name": name,
            "versions": package_versions(_PACKAGES)
            | plugin_versions(*((LAWS, name) for name in LAWS.names())),
            "machine": platform.machine(),
            "study": study.model_dump(mode="json", by_alias=True),
            "rules": asdict(ModelOptions()),
            "failed": len(found.failed),
        },
        timing={"traces": list(found.traces)} if found.traces else {},
        faults=tuple(f"{row.title}: {row.quantity} fails" for row in found.failed),
    )


def _tabulate_rows(found: Verification) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of the table, in the units that they name."""
    for row in found.rows:
        bounds = row.bound.low, row.bound.high
        place = row.group.title, row.title, row.quantity
        yield (*place, row.measured, *bounds, row.unit, row.verdict, row.remark)


def _tabulate_refinements(found: Verification) -> Iterator[tuple[Any, ...]]:
    """Yield every error of the refinement studies, with the observed order from one mesh size to the next."""
    for curve in found.curves:
        for norm, errors in curve.errors.items():
            for h, error, order in zip(curve.h, errors, [None, *curve.orders(norm)], strict=True):
                yield curve.case, norm, h, error, order
