"""What decides a result: versions of packages, data, configuration, rules of the model."""

import platform
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

from needlefit.datasets.insertion import Dataset, split_boundary_sd
from needlefit.datasets.needles import summarize_needles
from needlefit.datasets.sections import describe_measurement
from needlefit.inference.forward_model import make_options as mesh
from needlefit.mechanics.native import identify_other_library
from needlefit.registry import plugin_versions
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.run_metadata import DatasetMetadata, FoldMetadata, JobMetadata, RigidityMetadata
from needlefit.studies.identity import identify, list_fit_plugins, list_judging_plugins
from needlefit.studies.job import Job

#: whose versions decide the result of a study
PACKAGES = ("numpy", "scipy", "nlopt", "emcee", "pandas", "trimesh")


def describe_configuration(job: Job) -> JobMetadata:
    """Return everything that decides the result of a job."""
    plugins = list_fit_plugins(job.medium, job.dataset, job.recipe)
    return JobMetadata(
        name=job.name,
        versions=package_versions(PACKAGES) | plugin_versions(*plugins, *list_judging_plugins()),
        dataset=summarize_dataset(job.dataset),
        study=job.record.model_dump(mode="json", by_alias=True),
        identity=identify(job),
        medium=job.medium,
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
        rules=describe_model_options(job.medium),
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
        (only_needle,) = dataset.needles.values()
        needles = {
            "needle": {"length": only_needle.length, "flexural_rigidity": only_needle.flexural_rigidity}
        }
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


def describe_model_options(medium: MediumRecord) -> dict[str, Any]:
    """Return the model rules that fitted numbers depend on; fits with other rules cannot be compared."""
    keys = ("law", "advance", "constraint_spacing_mm", "constraint_switch", "tangent_part", "first_cell_mm")
    return {
        **{key: getattr(medium, key) for key in (*keys, "thickness_mm")},
        "element_mm": mesh(medium).element,
    }
