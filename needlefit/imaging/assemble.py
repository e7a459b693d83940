"""Reconstructions -> a dataset in a folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needlefit.datasets.schema import InsertionRow, as_id
from needlefit.datasets.write import write_dataset
from needlefit.errors import DataError
from needlefit.geometry.surfaces import Surface
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.project.records.dataset import (
    CenterlinesRecord,
    DatasetMediumRecord,
    DatasetRecord,
    FrameRecord,
    InsertionsRecord,
    NoiseRecord,
    SurfaceRecord,
)
from needlefit.project.records.reconstruction import ReconstructionRecord
from needlefit.project.records.scene import NeedleRecord


@dataclass(frozen=True)
class About:
    """What the makers of a dataset say of it; texts of `dataset.toml`, and a note for each medium."""

    name: str
    title: str = ""
    license: str = "not stated"
    source: str = "needlefit reconstruct"
    notes: str = ""
    media: Mapping[str, str] | None = None


def assemble(
    folder: Path, ones: Sequence[Reconstruction], recipe: ReconstructionRecord, about: About
) -> Path:
    """Write the dataset of all reconstructions into `folder`; return its `dataset.toml`.

    Surfaces that all scans of a medium share are written once, others (layers segmented in every scan) once
    for each insertion.

    Raises
    ------
    DataError
        If the scans of one medium have layers of different kinds or numbers, or the surfaces of two media
        would have one name.
    """
    media: dict[str, list[Reconstruction]] = {}
    for one in ones:
        media.setdefault(one.scan.medium, []).append(one)
    records: dict[str, DatasetMediumRecord] = {}
    surfaces: dict[str, Surface] = {}
    for name, group in media.items():
        records[name], files = _medium(name, group, (about.media or {}).get(name, ""))
        _require_new(files, surfaces, name)
        surfaces |= files
    return write_dataset(
        folder,
        _record(ones, recipe, about, records),
        [_row(one) for one in ones],
        {one.scan.id: np.column_stack([one.points, one.sd]) for one in ones},
        surfaces,
    )


def _record(
    ones: Sequence[Reconstruction],
    recipe: ReconstructionRecord,
    about: About,
    media: dict[str, DatasetMediumRecord],
) -> DatasetRecord:
    needle = recipe.needle
    synthetic = any(one.scan.origin == "synthetic" for one in ones)
    return DatasetRecord(
        schema_=1,
        name=about.name,
        title=about.title or about.name,
        origin="synthetic" if synthetic else "measured",
        license=about.license,
        source=about.source,
        notes=about.notes,
        frame=FrameRecord(name="world" if ones[0].registration else "patient (LPS)", pose="known"),
        needle=NeedleRecord(
            name=needle.name,
            length_mm=needle.length_mm,
            outer_diameter_mm=needle.diameter_mm,
            inner_diameter_mm=needle.inner_diameter_mm,
            youngs_modulus_gpa=needle.youngs_modulus_gpa,
            note=needle.note,
        ),
        noise=_noise(ones, recipe),
        insertions=InsertionsRecord(file="insertions.csv"),
        centerlines=CenterlinesRecord(pattern="centerlines/{id}.csv"),
        media=media,
    )


def _noise(ones: Sequence[Reconstruction], recipe: ReconstructionRecord) -> NoiseRecord:
    """Return what the reconstructions say of their errors, over all insertions.

    An axis drawn as a spline errs alike over half a knot's distance; what remains from point to point is the
    rounding of the files, and a tenth of the former stands for it.
    """
    sd = float(np.sqrt(np.mean(np.concatenate([one.sd for one in ones]) ** 2)))
    registered = float(np.mean([one.target_error.mean() for one in ones]))
    return NoiseRecord(
        registration_mean_mm=round(registered, 4),
        point_sd_mm=round(0.1 * sd, 4),
        correlated_sd_mm=round(sd, 4),
        correlation_length_mm=recipe.centerline.knot_mm / 2,
        note="Predicted by the reconstruction: the registration's from the markers' deviations, mean of "
        "entry and tip; the centreline's from the scatter of its cross-sections.",
    )


def _row(one: Reconstruction) -> InsertionRow:
    scan, met = one.scan, len(one.layers.sequence)
    sd = one.layers.sd
    return InsertionRow(
        id=scan.id,
        medium=scan.medium,
        specimen=scan.specimen,
        layers=met if scan.layers is None else scan.layers,
        layers_alternative=scan.layers_alternative,
        depth=one.depth,
        side=scan.side,
        entry=one.pose.origin,
        direction=one.pose.direction,
        bevel={"stated": scan.bevel, "bevel": one.frame.rotation[:, 1], "shape": None}[one.plane],
        pose_source=one.pose.source,
        pose_shift_sd=one.pose.shift_sd,
        pose_angle_sd=one.pose.angle_sd,
        boundary_sd=float(np.sqrt(np.mean(sd**2))) if len(sd) else 0.0,
        depth_sd=one.depth_sd,
        guide_distance=scan.guide_distance,
        patient=one.patient,
    )


def _medium(
    name: str, group: Sequence[Reconstruction], note: str
) -> tuple[DatasetMediumRecord, dict[str, Surface]]:
    """Return the record of a medium, and its files."""
    first = group[0].layers.surfaces
    for one in group[1:]:
        if [(s.kind, s.into) for s in one.layers.surfaces] != [(s.kind, s.into) for s in first]:
            raise DataError(
                f"the layers of {one.scan.id} are not those of {group[0].scan.id}",
                where=f"medium {name}",
                expected="in every scan of a medium the same kinds of surfaces, leading into the same layers",
                mend="give these scans media of different names, or the same layers",
            )
    shared = all(_same(one.layers.surfaces, first) for one in group)
    numbered = [f"{{id}}_{n}" for n in range(1, len(first) + 1)]  # what a segment is called may differ
    names = [f"layers/{stem}.stl" for stem in (_stems(name, first) if shared else numbered)]
    records = tuple(
        SurfaceRecord(file=file, kind=surface.kind, into=surface.into)
        for file, surface in zip(names, first, strict=True)
    )
    files = {
        file.replace("{id}", one.scan.id): surface
        for one in (group[:1] if shared else group)
        for file, surface in zip(names, one.layers.surfaces, strict=True)
    }
    return DatasetMediumRecord(surfaces=records, note=note), files


def _require_new(files: Mapping[str, Surface], written: Mapping[str, Surface], medium: str) -> None:
    """Refuse names that a medium shares with another: `a` with `b_c` and `a_b` with `c` both make `a_b_c`."""
    both = sorted(files.keys() & written.keys())
    if both:
        raise DataError(
            f"two media would write {both[0]}",
            where=f"medium {medium}",
            expected="names of media and surfaces that make different files",
            mend="rename the medium, or the file of the surface",
        )


def _stems(medium: str, surfaces: Sequence[Surface]) -> list[str]:
    """Return a file name for each surface: its own after the medium's, numbered where two are alike."""
    own = [as_id(surface.name.removeprefix(f"{medium}_"), "surface") for surface in surfaces]
    if len({name.lower() for name in own}) < len(own):  # not every file system tells a from A
        own = [f"{name}_{n}" for n, name in enumerate(own, start=1)]
    return [f"{medium}_{name}" for name in own]


def _same(one: Sequence[Surface], other: Sequence[Surface]) -> bool:
    return all(
        np.array_equal(a.mesh.vertices, b.mesh.vertices) and np.array_equal(a.mesh.faces, b.mesh.faces)
        for a, b in zip(one, other, strict=True)
    )
