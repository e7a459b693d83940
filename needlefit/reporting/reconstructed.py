"""A batch of reconstructed scans -> the folder of a dataset, with all that a person needs to judge it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from needlefit.datasets.sources import ScanVolume, write_volumes
from needlefit.imaging.assembly import DatasetDescription, assemble_checked
from needlefit.imaging.batch import VERSIONED_PACKAGES, ReconstructionFailure
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.project.atomic_write import replace_folder
from needlefit.project.progress import Progress
from needlefit.reporting.files import write_json
from needlefit.reporting.quality import write_quality
from needlefit.reporting.reconstructions import write_tables
from needlefit.reporting.slicer_scan import write_scan
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.validation.provenance import package_versions

ABOUT = "reconstruction.json"


def write_reconstructed(
    folder: Path,
    ones: Sequence[Reconstruction],
    recipe: ReconstructionRecord,
    about: DatasetDescription,
    progress: Progress,
) -> tuple[tuple[Reconstruction, ...], tuple[ReconstructionFailure, ...]]:
    """Write `folder`, whole or not at all; return what is in it, and what a dataset cannot hold.

    Where none can be held nothing is written, and what was there stays.

    The dataset, and where its scans lie; `reconstruction.csv`, `markers.csv`, `crossings.csv`;
    `quality/<id>.pdf`; `slicer/`; and `reconstruction.json`: versions and recipe.

    Raises
    ------
    DataError
        If the dataset has a fault that belongs to no single scan.
    ConfigError
        If `folder` holds anything that needlefit did not write, or that was changed since.
    """
    with replace_folder(folder) as fresh:
        kept, failures = assemble_checked(fresh, ones, recipe, about)
        if not kept:
            return kept, failures
        volumes = {one.scan.id: ScanVolume(one.scan.volume, one.scan.series) for one in kept}
        write_volumes(fresh, volumes, folder)
        write_tables(kept, fresh)
        for done, one in enumerate(kept):
            progress(f"{one.scan.id}: quality page", done, len(kept))
            write_quality(one, fresh / "quality" / f"{one.scan.id}.pdf")
            write_scan(one, fresh / "slicer", recipe.needle.diameter_mm)
        write_json(fresh / ABOUT, _said(recipe))
    return kept, failures


def _said(recipe: ReconstructionRecord) -> dict[str, Any]:
    return {
        "versions": package_versions(VERSIONED_PACKAGES),
        "recipe": recipe.model_dump(mode="json", by_alias=True),
    }
