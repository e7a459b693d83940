"""Write reconstructions as a dataset, without those that `needlefit check` would refuse."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from shutil import copytree
from tempfile import TemporaryDirectory

import numpy as np

from needlefit.datasets.columns import InsertionRow, make_id
from needlefit.datasets.faults import Fault, as_error
from needlefit.datasets.read import check
from needlefit.datasets.sections import SECTIONS_PATTERN
from needlefit.datasets.write import write_dataset
from needlefit.errors import DataError
from needlefit.geometry.surfaces import Surface
from needlefit.grouping import group_values
from needlefit.imaging.batch import ReconstructionFailure
from needlefit.imaging.constants import MM
from needlefit.imaging.corrections import list_control_points
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.schemas.dataset import (
    CenterlinesRecord,
    DatasetMediumRecord,
    DatasetRecord,
    FrameRecord,
    ImportRecord,
    InsertionsRecord,
    MeasurementRecord,
    NoiseRecord,
    SurfaceRecord,
)
from needlefit.schemas.origin import combine_origins
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.schemas.scene import NeedleRecord


@dataclass(frozen=True)
class DatasetDescription:
    """The texts of `dataset.toml` that describe a dataset, and a note for each medium."""

    name: str
    title: str = ""
    license: str = "not stated"
    source: str = "needlefit reconstruct"
    truth_seed: int | None = None
    truth_population: bool = False
    notes: str = ""
    media: Mapping[str, str] = field(default_factory=dict)


def assemble_dataset(
    folder: Path,
    reconstructions: Sequence[Reconstruction],
    recipe: ReconstructionRecord,
    description: DatasetDescription,
) -> Path:
    """Write the dataset of all reconstructions into `folder`; return its `dataset.toml`.

    Surfaces that all scans of a medium share are written once, others (layers segmented in every scan) once
    for each insertion.

    DataError if the scans of one medium have layers of different kinds or numbers, or the surfaces of two
    media would have one name.
    """
    media = group_values((needle.scan.medium, needle) for needle in reconstructions)
    records: dict[str, DatasetMediumRecord] = {}
    surfaces: dict[str, Surface] = {}
    for name, group in media.items():
        records[name], files = _medium_record(name, group, description.media.get(name, ""))
        # `a` with `b_c` and `a_b` with `c` both make `a_b_c`
        if both := sorted(files.keys() & surfaces.keys()):
            raise DataError(
                f"two media would write {both[0]}",
                expected="names of media and surfaces that make different files",
                fix="rename the medium, or the file of the surface",
                where=f"medium {name}",
            )
        surfaces |= files
    row_fields = InsertionRow.__dataclass_fields__
    rows = [
        InsertionRow(
            **{name: value for name, value in vars(needle.scan).items() if name in row_fields}
            | {
                "layers": needle.scan.layers or len(needle.layers.sequence),
                "guide_distance": needle.scan.guide_distance or None,
            },
            depth=needle.depth,
            entry=needle.pose.origin,
            direction=needle.pose.direction,
            pose_source=needle.pose.source,
            pose_shift_sd=needle.pose.shift_sd,
            pose_angle_sd=needle.pose.angle_sd,
            boundary_sd=float(np.sqrt(np.mean(needle.layers.sd**2))) if len(needle.layers.sd) else 0.0,
            depth_sd=needle.depth_sd,
            patient=needle.patient,
        )
        for needle in reconstructions
    ]
    return write_dataset(
        folder,
        _dataset_record(reconstructions, recipe, description, records),
        rows,
        {needle.scan.id: np.column_stack([needle.points, needle.sd]) for needle in reconstructions},
        surfaces,
        sections={
            needle.scan.id: needle.sections for needle in reconstructions if needle.sections is not None
        },
    )


def _dataset_record(
    reconstructions: Sequence[Reconstruction],
    recipe: ReconstructionRecord,
    description: DatasetDescription,
    media: dict[str, DatasetMediumRecord],
) -> DatasetRecord:
    needle, about = recipe.needle, vars(description)
    unrecorded = {"diameter_mm", "bevel_deg", "bevel_sd_deg"}
    drawn = all(scanned.sections is not None for scanned in reconstructions)
    sd = float(np.sqrt(np.mean(np.concatenate([scanned.sd for scanned in reconstructions]) ** 2)))
    registered = float(np.mean([scanned.target_error.mean() for scanned in reconstructions]))
    confirmed = {
        f"entry of {scanned.scan.id}": f"{scanned.depth:.2f} mm deep; {scanned.entry.confirmed}"
        for scanned in reconstructions
        if scanned.entry.confirmed
    }
    return DatasetRecord(
        **about | {"title": description.title or description.name, "media": media},
        schema_=1,
        origin=combine_origins(scanned.scan.origin for scanned in reconstructions),
        frame=FrameRecord(name="world" if reconstructions[0].registration else "patient (LPS)", pose="known"),
        needle=NeedleRecord(outer_diameter_mm=needle.diameter_mm, **needle.model_dump(exclude=unrecorded)),
        # An axis drawn as a spline errs alike over half a knot's distance; what remains from point to point
        # is the rounding of the files, and a tenth of the former stands for it. What the spline rounds is
        # no noise: it is in the stored cross-sections.
        noise=NoiseRecord(
            registration_mean_mm=round(registered, 4),
            point_sd_mm=round(0.1 * sd, 4),
            correlated_sd_mm=round(sd, 4),
            correlation_length_mm=MM.KNOT / 2,
            note="Predicted by the reconstruction: the registration's from the markers' deviations, mean of "
            "entry and tip; the centreline's is that of a smoothing spline at its points, from the scatter "
            "of its cross-sections, without what the spline rounds.",
        ),
        insertions=InsertionsRecord(file="insertions.csv"),
        centerlines=CenterlinesRecord(pattern="centerlines/{id}.csv"),
        # centrelines are splines through stored cross-sections, if all of them are
        measurement=MeasurementRecord(operator="spline", sections=SECTIONS_PATTERN) if drawn else None,
        import_=ImportRecord(confirmed=confirmed) if confirmed else None,
    )


def _medium_record(
    name: str, group: Sequence[Reconstruction], note: str
) -> tuple[DatasetMediumRecord, dict[str, Surface]]:
    """Return the record of a medium, and its files."""
    first = group[0].layers.surfaces
    for one in group[1:]:
        if [(s.kind, s.into) for s in one.layers.surfaces] != [(s.kind, s.into) for s in first]:
            raise DataError(
                f"the layers of {one.scan.id} are not those of {group[0].scan.id}",
                expected=(
                    "in every scan of a medium the same kinds of surfaces, leading into the same layers"
                ),
                fix="give these scans media of different names, or the same layers",
                where=f"medium {name}",
            )
    shared = all(
        np.array_equal(a.vertices, b.vertices) and np.array_equal(a.faces, b.faces)
        for one in group
        for a, b in zip(one.layers.surfaces, first, strict=True)
    )
    stems = [f"{{id}}_{n}" for n in range(1, len(first) + 1)]  # what a segment is called may differ
    if shared:
        # each its own after the medium's, numbered where two are alike: not every system tells a from A
        own = [make_id(surface.name.removeprefix(f"{name}_"), "surface") for surface in first]
        alike = len({stem.lower() for stem in own}) < len(own)
        stems = [f"{name}_{stem}" + f"_{n}" * alike for n, stem in enumerate(own, start=1)]
    records = tuple(
        SurfaceRecord(file=f"layers/{stem}.stl", kind=surface.kind, into=surface.into)
        for stem, surface in zip(stems, first, strict=True)
    )
    files = {  # of those that all share each time the same
        record.file.replace("{id}", one.scan.id): surface
        for one in group
        for record, surface in zip(records, one.layers.surfaces, strict=True)
    }
    return DatasetMediumRecord(surfaces=records, note=note), files


def assemble_checked(
    folder: Path,
    reconstructions: Sequence[Reconstruction],
    recipe: ReconstructionRecord,
    description: DatasetDescription,
) -> tuple[tuple[Reconstruction, ...], tuple[ReconstructionFailure, ...]]:
    """Write the dataset of all `reconstructions` without faults into `folder`; return them and the others.

    Where all have a fault, or make no dataset together, nothing is written and the first tuple is empty.
    """
    errors: dict[str, Fault] = {}  # by the id of the needle
    kept = reconstructions
    if faults := _assemble_faultless(folder, kept, recipe, description):
        for needle in reconstructions:
            if own := _assemble_faultless(None, [needle], recipe, description):
                what = "; ".join(dict.fromkeys(fault.what for fault in own))
                errors[needle.scan.id] = own[0].replace(
                    what=f"gives no insertion that a dataset may hold: {what}", where=needle.scan.volume
                )
        kept = [needle for needle in reconstructions if needle.scan.id not in errors]
        if errors and kept:
            faults = _assemble_faultless(folder, kept, recipe, description)
        if faults:
            shared = as_error(faults, Path(description.name))
            errors |= {needle.scan.id: shared for needle in kept}
            kept = []
    return tuple(kept), tuple(
        ReconstructionFailure(needle.scan, errors[needle.scan.id], list_control_points(needle))
        for needle in reconstructions
        if needle.scan.id in errors
    )


def _assemble_faultless(
    folder: Path | None,
    reconstructions: Sequence[Reconstruction],
    recipe: ReconstructionRecord,
    description: DatasetDescription,
) -> list[Fault]:
    """Return the faults of the dataset of some reconstructions; write it into `folder` if it has none.

    The places of faults count from the folder.
    """
    with TemporaryDirectory(prefix="needlefit-") as name:
        fresh = Path(name, "dataset")
        try:
            assemble_dataset(fresh, reconstructions, recipe, description)
        except DataError as error:
            return [error]
        faults = [
            fault.replace(
                where=fault.where.replace(f"{fresh}/", ""),
                fix=fault.fix.replace("dataset.toml", "the recipe"),  # what its user has written
            )
            for fault in check(fresh)
        ]
        if folder is not None and not faults:
            copytree(fresh, folder, dirs_exist_ok=True)
        return faults
