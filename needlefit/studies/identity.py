"""The identity of a fit or study: one digest of all that decides it, by which results are compared.

It does not depend on names, titles and folders, nor on the machine. Where two differ, the digests of their
parts show which part does.
"""

from collections.abc import Mapping
from typing import Any

from needlefit.datasets.formats import FORMATS
from needlefit.datasets.insertion import Dataset
from needlefit.datasets.select import name_holes
from needlefit.inference.baselines import BASELINES
from needlefit.inference.likelihood.observations import OBSERVATIONS
from needlefit.inference.sampling.samplers import SAMPLERS
from needlefit.mechanics.laws import LAWS
from needlefit.metrics import METRICS
from needlefit.project.json_values import digest_values
from needlefit.project.locate import join_names
from needlefit.registry import plugin_versions
from needlefit.schemas.deciding import select_deciding
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.run_metadata import FitIdentity, RunMetadata
from needlefit.schemas.study import StudyRecord
from needlefit.studies.job import Job

VERSION = 1  #: of what files mean; raise it when the same files mean another fit, as by another default
PART_DIGITS = 16  #: of the digests of parts, which are only looked at where the whole ones differ

#: keys of a study of which what follows counts: the contents of files, and the insertions selected
RESOLVED = frozenset(
    (
        *("dataset", "medium", "recipe", "priors", "fix", "paper_parameters", "compared"),
        *("tune", "validate_", "leave_out", "folds", "layer_count_rule"),
    )
)
#: keys of a study, and of a recipe, that decide only how predictions of held-out insertions are judged
JUDGING = frozenset(("margin_mm", "same_specimen", "registration_depth_mm", "aiming_width_mm"))


def identify(job: Job, analysis: object = None) -> FitIdentity:
    """Return the identity of a fit, or of its analysis with these options.

    That of a study is also of what it holds out, and of how predictions of that are judged.
    """
    record = job.record
    holes = name_holes(job.dataset)  # insertions of one hole share a bevel
    plugins = plugin_versions(*list_fit_plugins(job.medium, job.dataset, job.recipe))
    parts: dict[str, object] = {
        "options": {
            "stated": select_deciding(record, RESOLVED | JUDGING),
            "compared": job.dataset.compared,
            "paper_parameters": job.hand_tuned,
        },
        "tissue model": select_deciding(job.medium),
        "recipe": select_deciding(job.recipe, JUDGING),
        "folds": {
            fold.name: [
                [(insertion.id, holes[insertion.id]) for insertion in side]
                for side in (fold.tune, fold.validate)
            ]
            for fold in job.folds
        },
        "version": [VERSION, plugins],
    }
    if isinstance(record, StudyRecord):
        parts["judgement of predictions"] = {
            "stated": [getattr(of, key, None) for of in (record, job.recipe) for key in sorted(JUDGING)],
            "plugins": plugin_versions(*list_judging_plugins()),
        }
    if analysis is not None:
        parts["options of the analysis"] = analysis
    return make_identity(parts, {insertion.id: insertion.digest for insertion in job.insertions})


def make_identity(parts: Mapping[str, object], data: Mapping[str, str]) -> FitIdentity:
    """Return the identity of what these parts decide, and data, by insertion, with these digests."""
    digests = {name: digest_values(part)[:PART_DIGITS] for name, part in parts.items()}
    data = {name: digest[:PART_DIGITS] for name, digest in data.items()}
    return FitIdentity(sha256=digest_values([digests, data]), parts=digests, insertions=data)


def list_fit_plugins(medium: MediumRecord, dataset: Dataset, recipe: RecipeRecord) -> list[tuple[Any, str]]:
    """Return what may be a plugin's and decides a fit: its registry, and its name there."""
    observations = {(OBSERVATIONS, insertion.observation) for insertion in dataset.insertions}
    sampler = (SAMPLERS, recipe.sample.sampler)
    return [(LAWS, medium.law), (FORMATS, dataset.centerline_format), sampler, *observations]


def list_judging_plugins() -> list[tuple[Any, str]]:
    """Return what may be a plugin's and is computed of every prediction."""
    return [(registry, name) for registry in (METRICS, BASELINES) for name in registry.names()]


# ---- comparisons


def describe_change(before: FitIdentity | None, after: FitIdentity | None) -> str:
    """Return what changed of a fit or study between two results of it; "" where they are of the same."""
    if before is None or after is None:
        return "unknown, as an earlier version did not record its inputs"
    if before.sha256 == after.sha256:
        return ""
    old, new, parts = before.insertions, after.insertions, before.parts | after.parts
    ids = {
        "removed": old.keys() - new.keys(),
        "added": new.keys() - old.keys(),
        "with other data": {name for name in old.keys() & new.keys() if old[name] != new[name]},
    }
    changed = {key for key in parts if before.parts.get(key) != after.parts.get(key)}
    if old.keys() != new.keys():
        changed.discard("folds")  # which follow
    named = "; ".join(f"{join_names(sorted(names))} {change}" for change, names in ids.items() if names)
    return ", ".join([*([f"insertions ({named})"] if named else []), *sorted(changed)])


def has_data(recorded: RunMetadata, dataset: Dataset) -> bool:
    """Return whether a dataset has the files of a result, or at least the data of all its insertions."""
    if recorded.dataset is not None and dataset.digest == recorded.dataset.sha256:
        return True
    digests = {insertion.id: insertion.digest[:PART_DIGITS] for insertion in dataset.insertions}
    identity = recorded.identity
    return identity is not None and identity.insertions.items() <= digests.items()
