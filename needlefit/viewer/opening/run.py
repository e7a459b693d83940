"""An insertion as a run fitted it, or foretold it, as what is shown."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.read import read
from needlefit.errors import DataError
from needlefit.inference.as_scene import layers_met
from needlefit.project.places import find
from needlefit.project.reading import stored_values
from needlefit.project.records.medium import MediumRecord
from needlefit.project.subjects import Named
from needlefit.validation.packing import unpack
from needlefit.validation.results import Results
from needlefit.validation.stored import restore
from needlefit.viewer.opening.insertion import Shown, choose, subject_of
from needlefit.viewer.overlay.band import Spread, spread_of
from needlefit.viewer.subject import Subject

DRAWS = 100
"""Needles of a band."""

FITTED = "fitted"
"""The rival whose parameters are shown."""

_CROSSED = "Its layers lie where it was measured to cross them. "


def open_run(named: Named) -> Subject:
    """Return an insertion with the parameters of a run, by default the first that its fit never saw.

    Raises
    ------
    DataError
        If the run is of another kind or damaged, found no parameters, or its data have changed since.
    ConfigError
        If it has no such insertion; the nearest are listed.
    """
    with stored_values(named.path):
        return _opened(named)


def _opened(named: Named) -> Subject:
    _require_fit(named.path)
    results = restore(named.path)
    dataset = _unchanged(results, named.path)
    roles = _roles(results)
    by_id = {insertion.id: insertion for insertion in dataset.insertions}
    insertion = choose(tuple(by_id[id_] for id_ in roles), named, f"insertion of run {named.name}")
    role = roles[insertion.id]
    draws = results.draws[results.draws["fold"] == role.fold]
    shown = Shown(
        dataset=dataset,
        insertion=insertion,
        medium=MediumRecord.model_validate(results.run["medium"]),
        values=_values(results, role.fold, named.path),
        seed=results.run["recipe"]["seed"],
    )
    crossed = _CROSSED if len(insertion.boundaries) else ""
    said = f"Parameters: fitted by {results.name}, {role.said}. {crossed}{_told(draws)}"
    subject = subject_of(shown, named.name, said, tuple(roles))
    return subject if draws.empty else replace(subject, spread=_spread(draws, insertion))


def _spread(draws: pd.DataFrame, insertion: Insertion) -> Spread:
    """Return some of the draws, evenly spread over all, for the layers that an insertion meets."""
    chosen = draws.iloc[np.linspace(0, len(draws) - 1, min(DRAWS, len(draws))).astype(np.int64)]
    return spread_of(chosen, [layer for _, layer in layers_met(insertion)])


@dataclass(frozen=True)
class _Role:
    """In which fold an insertion stands, and as what."""

    fold: str
    said: str


def _roles(results: Results) -> dict[str, _Role]:
    """Return the role of every insertion of a run by its id, those first that a fit never saw."""
    folds: list[Mapping[str, Any]] = results.run["folds"]
    held = {id_: _Role(fold["name"], "which never saw it") for fold in folds for id_ in fold["validate"]}
    tuned = {id_: _Role(fold["name"], "on this needle too") for fold in folds for id_ in fold["tune"]}
    return held | {id_: role for id_, role in tuned.items() if id_ not in held}


def _values(results: Results, fold: str, where: Path) -> dict[str, float]:
    """Return the fitted value of every parameter (Pa, mm)."""
    rows = results.parameters
    rows = rows[(rows["fold"] == fold) & (rows["rival"] == FITTED)]
    if rows.empty:
        raise DataError(
            "its fit found no parameters with which every needle can be solved",
            where=str(where),
            expected="a run whose fit ended",
            mend="look at its report, or run it again",
        )
    return dict(zip(rows["parameter"], rows["value"].astype(float), strict=True))


def _told(draws: pd.DataFrame) -> str:
    """Return what there is to say of the band."""
    if draws.empty:
        return "No band: the run stored no draws of its parameters, as it was interrupted."
    first = draws.iloc[0]
    how = {"posterior": "of its sampled posterior", "importance": "weighed about its fit"}[first["from"]]
    doubt = "" if first["certified"] else "; they have not converged, so its width is not to be trusted"
    return f"Band: 95 % of the needles of draws {how}{doubt}."


def _require_fit(folder: Path) -> None:
    kind = unpack(folder).get("kind")
    if kind not in ("study", "fit"):
        raise DataError(
            f"is a run of another kind ({kind}): it has no fitted needle to show",
            where=str(folder),
            expected="a run of tune or validate that fits the shapes of needles",
            mend="name such a run, or a scene or an insertion of a dataset",
        )


def _unchanged(results: Results, where: Path) -> Dataset:
    """Return the data of a run; DataError if they are not what it was fitted to."""
    dataset = read(find("dataset", results.record.dataset))
    if dataset.digest != results.run["dataset"]["sha256"]:
        raise DataError(
            f"its dataset, {dataset.name}, has changed since",
            where=str(where),
            expected=f"{dataset.path} as it was then",
            mend=f"run {results.name} again, or restore the data",
        )
    return dataset
