"""Show an insertion with the parameters that a run fitted."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.read import read_shapes
from needlefit.errors import DataError
from needlefit.inference.forward_model import find_layers
from needlefit.inference.parameter_draws import ParameterDraws, select_layer_draws
from needlefit.inference.parameters import BEVEL_SPREAD, Parameters
from needlefit.inference.problem import find_new_bevel_sd
from needlefit.inference.specimens import SpecimenSpread, move_to_new_specimen
from needlefit.project.input_files import convert_stored_errors
from needlefit.project.locate import find_file
from needlefit.project.random_streams import random_stream
from needlefit.project.view_targets import SpecimenChoice, ViewTarget
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.studies.job import Inputs, Settings, prepare
from needlefit.studies.kinds.cross_validation.results import FIT_KINDS
from needlefit.studies.new_specimens import NewSpecimens
from needlefit.studies.packing import unpack
from needlefit.studies.planned_draws import vary_bevels
from needlefit.studies.report import list_run_warnings
from needlefit.studies.run import Run, restore_run
from needlefit.viewer.opening.insertion import choose_insertion, make_viewed_scene
from needlefit.viewer.viewed_scene import ShownInsertion, ViewedScene

SHOWN_METHOD = "fitted"
"""The method whose parameters are shown."""

_LAYERS_NOTE = "Its layers lie where it was measured to cross them. "


def open_run(view_target: ViewTarget) -> ViewedScene:
    """Return an insertion with the fitted parameters of a run, by default the first held-out one.

    Raises
    ------
    DataError
        If the run is of another kind or damaged, found no parameters, or its data have changed since.
    ConfigError
        If it has no such insertion; the nearest are listed.
    """
    with convert_stored_errors(view_target.path):
        return _open(view_target)


def _open(view_target: ViewTarget) -> ViewedScene:
    _require_fit(view_target.path)
    results = restore_run(view_target.path)
    dataset = _read_unchanged_dataset(results, view_target.path)
    roles = _find_roles(results)
    by_id = {insertion.id: insertion for insertion in dataset.insertions}
    insertion = choose_insertion(
        tuple(by_id[id_] for id_ in roles), view_target, f"insertion of run {view_target.name}"
    )
    role = roles[insertion.id]
    draws = results.frames["draws"][results.frames["draws"]["fold"] == role.fold]
    shown = ShownInsertion(
        dataset=dataset,
        insertion=insertion,
        medium=MediumRecord.model_validate(results.run["medium"]),
        values=_fitted_values(results, role.fold, view_target.path),
        seed=results.run["recipe"]["seed"],
    )
    spread = _choose_spread(results, role.fold, shown, view_target.specimen)
    crossed = _LAYERS_NOTE if len(insertion.boundaries) else ""
    description = (
        f"Parameters: fitted by {results.name}, {role.description}. {crossed}{_describe_band(draws, spread)}"
    )
    viewed_scene = make_viewed_scene(shown, view_target.name, description, tuple(roles))
    known = {(one.kind, one.what) for one in viewed_scene.warnings}  # of the dataset, with the paths of files
    warnings = [one for one in list_run_warnings(results) if (one.kind, one.what) not in known]
    viewed_scene = replace(viewed_scene, faults=results.faults, warnings=(*warnings, *viewed_scene.warnings))
    if draws.empty or not draws["certified"].all():
        return viewed_scene
    independent = results.run["recipe"]["likelihood"]["depths"] == "quadrature"  # of each insertion's bevel
    fitted = _list_fitted(results, role.fold, dataset)
    new_bevel_sd = 1.0 if independent else find_new_bevel_sd(dataset, fitted)
    return replace(
        viewed_scene,
        spread=_vary_draws(results, draws, spread, insertion, new_bevel_sd),
        specimen="same" if spread is None else "new",
    )


@dataclass(frozen=True)
class _StoredSpread:
    """By how much an insertion's specimen was predicted to differ from the `fitted` ones tuned on."""

    between: SpecimenSpread
    fitted: int


def _list_fitted(results: Run, fold: str, dataset: Dataset) -> list[Insertion]:
    (tuned,) = (set(one["tune"]) for one in results.run["folds"] if one["name"] == fold)
    return [one for one in dataset.insertions if one.id in tuned]


def _choose_spread(
    results: Run, fold: str, shown: ShownInsertion, specimen: SpecimenChoice
) -> _StoredSpread | None:
    """Return by how much the specimen of the draws differs from those tuned on; None if it is one of them."""
    if specimen == "planned":
        specimen = "new" if results.record.specimens == "others" else "same"
    if specimen == "same":
        return None
    stored = _find_stored_spread(results, fold, shown)
    return _learn_spread(results, fold, shown) if stored is None and specimen == "new" else stored


def _find_stored_spread(results: Run, fold: str, shown: ShownInsertion) -> _StoredSpread | None:
    """Return by how much a run took a specimen to differ; None if it took it for one tuned on."""
    rows = results.frames.get("predictive", pd.DataFrame(columns=["fold", "insertion"]))
    rows = rows[(rows["fold"] == fold) & (rows["insertion"] == shown.insertion.id)]
    if rows.empty or rows.iloc[0].get("specimen_treatment") != "others":
        return None
    row = rows.iloc[0]
    taus = np.array([[row["between_sd_ln_mu"], row["between_sd_ln_b"]]], dtype=np.float64)
    fitted = {one.specimen for one in _list_fitted(results, fold, shown.dataset)}
    return _StoredSpread(SpecimenSpread(taus, np.ones(1), int(row["other_specimens"])), len(fitted))


def _learn_spread(results: Run, fold: str, shown: ShownInsertion) -> _StoredSpread:
    """Return by how much a specimen differs that the run did not predict, as it would have done."""
    recipe = RecipeRecord.model_validate(results.run["recipe"])
    inputs = Inputs(dataset=shown.dataset, medium=shown.medium, recipe=recipe)
    job = prepare(results.name, results.record, Settings(inputs=inputs))
    (tuned,) = (one for one in job.folds if one.name == fold)
    new = NewSpecimens(job, tuned, job.parameters.theta(shown.values))
    fitted = {one.specimen for one in tuned.tune}
    target = None if shown.insertion.specimen in fitted else shown.insertion
    return _StoredSpread(new.find_spread(target), len(fitted))


def _vary_draws(
    results: Run,
    draws: pd.DataFrame,
    spread: _StoredSpread | None,
    insertion: Insertion,
    new_bevel_sd: float,
) -> ParameterDraws:
    """Return the draws for the layers that an insertion meets.

    Each has a bevel of its own. In a new specimen they differ as much as others do (root mean square).
    """
    rng = random_stream(results.run["recipe"]["seed"], "band", insertion.id)
    record = MediumRecord.model_validate(results.run["medium"])
    medium = Parameters.from_record(record)
    names = [name for name in (*medium.names, BEVEL_SPREAD) if name in draws]
    sets = [dict(zip(names, row, strict=True)) for row in draws[names].to_numpy(dtype=np.float64).tolist()]
    if spread is not None:
        thetas = np.array([medium.theta(values) for values in sets])
        moved = move_to_new_specimen(medium, thetas, spread.between, spread.fitted, rng)
        sets = [values | medium.values(theta) for values, theta in zip(sets, moved, strict=True)]
    varied = vary_bevels(sets, new_bevel_sd, rng)
    layers = [layer for _, layer in find_layers(insertion)]
    return select_layer_draws(pd.DataFrame(varied), layers, record.law)


@dataclass(frozen=True)
class _InsertionRole:
    """In which fold an insertion stands, and as what."""

    fold: str
    description: str


def _find_roles(results: Run) -> dict[str, _InsertionRole]:
    """Return the role of every insertion of a run by its id, those first that a fit never saw."""
    folds: list[Mapping[str, Any]] = results.run["folds"]
    held = {
        id_: _InsertionRole(fold["name"], "which never saw it") for fold in folds for id_ in fold["validate"]
    }
    tuned = {
        id_: _InsertionRole(fold["name"], "on this needle too") for fold in folds for id_ in fold["tune"]
    }
    return held | {id_: role for id_, role in tuned.items() if id_ not in held}


def _fitted_values(results: Run, fold: str, where: Path) -> dict[str, float]:
    """Return the fitted value of every parameter (Pa, mm)."""
    rows = results.frames["parameters"]
    rows = rows[(rows["fold"] == fold) & (rows["method"] == SHOWN_METHOD)]
    if rows.empty:
        raise DataError(
            "its fit found no parameters with which every needle can be solved",
            where=str(where),
            expected="a run whose fit ended",
            fix="look at its report, or run it again",
        )
    return dict(zip(rows["parameter"], rows["value"].astype(float), strict=True))


def _describe_band(draws: pd.DataFrame, spread: _StoredSpread | None) -> str:
    """Return what there is to say of the band."""
    if draws.empty:
        return "No band: the run stored no draws of its parameters, as it was interrupted."
    first = draws.iloc[0]
    how = {"posterior": "of its sampled posterior", "importance": "importance-weighted about its fit"}[
        first["draw_source"]
    ]
    if not draws["certified"].all():
        return f"No band: the draws {how} are not certified."
    specimen = ""
    if spread is not None:
        mu, b = np.exp(spread.between.rms)
        specimen = (
            ", in a specimen that was not tuned on, whose moduli differ by a factor of "
            f"{mu:.2g} and whose bevel parameter by {b:.2g}"
        )
    return f"Band: 95 % of the needles of draws {how}{specimen}."


def _require_fit(folder: Path) -> None:
    kind = unpack(folder).get("kind")
    if kind not in FIT_KINDS:
        raise DataError(
            f"is a run of another kind ({kind}): it has no fitted needle to show",
            where=str(folder),
            expected="a run of tune or validate that fits the shapes of needles",
            fix="name such a run, or a scene or an insertion of a dataset",
        )


def _read_unchanged_dataset(results: Run, where: Path) -> Dataset:
    """Return the data of a run; DataError if they are not what it was fitted to."""
    dataset = read_shapes(find_file("dataset", results.record.dataset))
    if dataset.digest != results.run["dataset"]["sha256"]:
        raise DataError(
            f"its dataset, {dataset.name}, has changed since",
            where=str(where),
            expected=f"{dataset.path} as it was then",
            fix=f"run {results.name} again, or restore the data",
        )
    return dataset
