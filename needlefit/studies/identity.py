"""What decides a result (versions, data, configuration, rules), and its identity: one digest of all that.

Results are compared by it. It does not depend on names, titles and folders, nor on the machine. Where two
differ, the digests of their parts show which part does.
"""

import platform
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

from needlefit.datasets.formats import FORMATS
from needlefit.datasets.insertion import Dataset, split_boundary_sd
from needlefit.datasets.needles import summarize_needles
from needlefit.datasets.sections import describe_measurement
from needlefit.datasets.select import name_holes
from needlefit.inference.baselines import BASELINES
from needlefit.inference.forward_model import make_options as mesh
from needlefit.inference.likelihood.observations import OBSERVATIONS
from needlefit.inference.sampling.samplers import SAMPLERS
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.native import identify_other_library
from needlefit.metrics import METRICS
from needlefit.project.input_files import digest_values
from needlefit.project.locate import join_names
from needlefit.registry import plugin_versions
from needlefit.schemas.deciding import select_deciding
from needlefit.schemas.run_metadata import (
    DatasetMetadata,
    FitIdentity,
    FoldMetadata,
    JobMetadata,
    RigidityMetadata,
    RunMetadata,
)
from needlefit.schemas.study import StudyRecord
from needlefit.studies.job import Job

#: version of what files mean; raise it when the same files mean another fit, as by another default
VERSION = 1
#: number of digits of the digests of parts, which are only compared where the whole ones differ
PART_DIGITS = 16

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
    plugins = plugin_versions(*list_fit_plugins(job))
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
    digests = {name: digest_values(part)[:PART_DIGITS] for name, part in parts.items()}
    data = {insertion.id: insertion.digest()[:PART_DIGITS] for insertion in job.insertions}
    return FitIdentity(sha256=digest_values([digests, data]), parts=digests, insertions=data)


def list_fit_plugins(job: Job) -> list[tuple[Any, str]]:
    """Return what may be a plugin's and decides a fit: its registry, and its name there."""
    observations = {(OBSERVATIONS, insertion.observation) for insertion in job.dataset.insertions}
    formats, sampler = (FORMATS, job.dataset.centerline_format), (SAMPLERS, job.recipe.sample.sampler)
    return [(LAWS, job.medium.law), formats, sampler, *observations]


def list_judging_plugins() -> list[tuple[Any, str]]:
    """Return what may be a plugin's and is computed of every prediction."""
    return [(registry, name) for registry in (METRICS, BASELINES) for name in registry.names()]


# ---- comparisons


def describe_change(before: FitIdentity | None, after: FitIdentity | None) -> str:
    """Return what changed of a fit or study between two results of it; "" where they are of the same."""
    if before is None or after is None:
        return "unknown: its inputs were not recorded"
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
    digests = {insertion.id: insertion.digest()[:PART_DIGITS] for insertion in dataset.insertions}
    identity = recorded.identity
    return identity is not None and identity.insertions.items() <= digests.items()


# ---- what decides a result, as `run.json` states it

#: packages whose versions decide the result of a study
PACKAGES = ("numpy", "scipy", "nlopt", "emcee", "pandas", "trimesh")


def describe_configuration(job: Job) -> JobMetadata:
    """Return everything that decides the result of a job."""
    plugins, medium = [*list_fit_plugins(job), *list_judging_plugins()], job.medium
    rules = ("law", "advance", "constraint_spacing_mm", "constraint_switch", "tangent_part", "first_cell_mm")
    return JobMetadata(
        name=job.name,
        versions=package_versions(PACKAGES) | plugin_versions(*plugins),
        dataset=summarize_dataset(job.dataset),
        study=job.record.model_dump(mode="json", by_alias=True),
        identity=identify(job),
        medium=medium,
        recipe=job.recipe,
        hand_tuned=None if job.hand_tuned is None else dict(job.hand_tuned),
        folds=[
            FoldMetadata(
                name=fold.name,
                tune=[insertion.id for insertion in fold.tune],
                held_out=[insertion.id for insertion in fold.validate],
            )
            for fold in job.folds
        ],
        rules={
            **{key: getattr(medium, key) for key in (*rules, "thickness_mm")},
            "element_mm": mesh(medium).element,
        },
        compared=job.dataset.compared,
    )


def summarize_dataset(dataset: Dataset) -> DatasetMetadata:
    """Return which data these are, their needles, and what their measurement does to shapes.

    A single needle stands alone; several stand by their names.
    """
    stated = dataset.measurement.model_dump(mode="json", exclude_none=True, exclude={"note"})
    shared = {
        split_boundary_sd(insertion)[0] for insertion in dataset.insertions if len(insertion.boundaries)
    }
    needles: dict[str, Any] = {"needles": summarize_needles(dataset)}
    if len(dataset.needles) == 1:
        (needle,) = dataset.needles.values()
        needles = {"needle": {key: getattr(needle, key) for key in ("length", "flexural_rigidity")}}
    return DatasetMetadata(
        name=dataset.name,
        origin=dataset.origin,
        sha256=dataset.digest,
        notes=list(dataset.notes),
        measurement=stated | {"description": describe_measurement(dataset)},
        boundary_shared_sd_mm=sorted(shared - {0.0}),
        rigidity={
            name: RigidityMetadata(nmm2=needle.flexural_rigidity, origin=dataset.rigidities.get(name, ""))
            for name, needle in sorted(dataset.needles.items())
        },
        **needles,
    )


def package_versions(packages: Sequence[str]) -> dict[str, str]:
    """Return the versions of Python, of needlefit and of these packages; and which other kernel computes."""
    versions = {package: version(package) for package in ("needlefit", *packages)}
    if other := identify_other_library():
        versions["kernel"] = f"not the package's: SHA-256 {other}"
    return {"python": platform.python_version(), **versions}
