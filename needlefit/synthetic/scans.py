"""Write the synthetic dataset as CT volumes, in a folder for `needlefit reconstruct`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.columns import BEVEL_COLUMNS, DIRECTION_COLUMNS, ENTRY_COLUMNS
from needlefit.geometry.surfaces import write_surface
from needlefit.imaging.scans import LayerSource, Scan, StagePose
from needlefit.imaging.volume_files import write_volume
from needlefit.project.processes import one_thread
from needlefit.project.progress import Progress
from needlefit.project.tasks import TaskPool, run_in_order
from needlefit.project.toml_text import dumps
from needlefit.schemas.reconstruction import MarkersRecord, ReconstructionRecord, ScannedNeedleRecord
from needlefit.synthetic.design import PlannedInsertion
from needlefit.synthetic.exposure import Exposure, ScanSetup, acquire, choose_setup, expose
from needlefit.synthetic.insertion import SyntheticInsertion, simulate_insertion
from needlefit.synthetic.phantoms import PHANTOMS, make_surfaces, surface_file_name
from needlefit.synthetic.truth import POSE_ANGLE_SD_DEG, POSE_SHIFT_SD_MM

STATED_COLUMNS = (
    *("id", "scan", "medium", "specimen", "markers", "surfaces", "surfaces_in"),
    *(
        *ENTRY_COLUMNS,
        *DIRECTION_COLUMNS,
        "pose_shift_sd_mm",
        "pose_angle_sd_deg",
        *BEVEL_COLUMNS,
        "bevel_side",
    ),
    *("layers", "layers_alternative", "origin"),
)
"""The columns of `scans.csv` that the twin fills."""


def format_scans(scans: Sequence[Scan], folder: Path) -> str:
    """Return the text of the table of `scans`; file names are relative to `folder`."""
    rows = [STATED_COLUMNS, *(_scan_cells(scan, folder) for scan in scans)]
    return "".join(",".join(row) + "\n" for row in rows)


def format_markers(places: NDArray[np.float64]) -> str:
    """Return the text of the table of stated marker positions (M, 3), world, mm."""
    rows = [f"ball{n},{x:.4f},{y:.4f},{z:.4f}" for n, (x, y, z) in enumerate(places, start=1)]
    return "\n".join(["name,x_mm,y_mm,z_mm", *rows]) + "\n"


def _scan_cells(scan: Scan, folder: Path) -> tuple[str, ...]:
    surfaces = ";".join(_surface_cell(source, folder) for source in scan.surfaces)
    return (
        *(scan.id, _relative_path(scan.volume, folder), scan.medium, scan.specimen),
        *(_relative_path(scan.markers, folder), surfaces, scan.surfaces_in if surfaces else ""),
        *_stage_cells(scan.stage),
        *_number_cells(scan.bevel, 6),
        f"{scan.side:+d}",
        *("" if count is None else str(count) for count in (scan.layers, scan.layers_alternative)),
        scan.origin,
    )


def _surface_cell(source: LayerSource, folder: Path) -> str:
    return f"{_relative_path(source.path, folder)}={source.kind}:{source.into}"


def _stage_cells(stage: StagePose | None) -> tuple[str, ...]:
    if stage is None:
        return ("",) * 8
    deviations = np.array([stage.shift_sd, math.degrees(stage.angle_sd)])
    return (*_number_cells(stage.entry, 4), *_number_cells(stage.direction, 6), *_number_cells(deviations, 4))


def _relative_path(path: Path | None, folder: Path) -> str:
    return "" if path is None else path.relative_to(folder).as_posix()


def _number_cells(values: NDArray[np.float64] | None, digits: int) -> tuple[str, ...]:
    """Return the cells of `values`, three empty ones for none; never "-0.0000"."""
    if values is None:
        return ("", "", "")
    # adding 0.0 turns -0.0 into 0.0
    return tuple(f"{round(float(value), digits) + 0.0:.{digits}f}" for value in values)


VolumeFormat = Literal["nrrd", "dicom"]


@dataclass(frozen=True)
class RenderedInsertion:
    """One insertion, its exposure, and the scan as a user gets it."""

    insertion: SyntheticInsertion
    exposure: Exposure
    scan: Scan


@one_thread
def write_scans(
    folder: Path,
    plan: Sequence[PlannedInsertion],
    seed: int,
    form: VolumeFormat,
    pool: TaskPool,
    progress: Progress,
) -> Path:
    """Render `plan` into the empty `folder`; return its `scans.csv`. The same seed gives the same bytes.

    Parameters
    ----------
    pool : TaskPool
        Where they are rendered: on this machine, whose folder they write.
    progress : callable
        Told what is being done, how many insertions are done, and of how many.
    """
    write_layers(folder, plan)
    scans = []
    progress("rendering", 0, len(plan))
    for done in run_in_order(partial(_render_scan, folder, seed, form), plan, pool):
        scans.append(done)
        progress(f"rendered {done.id}", len(scans), len(plan))
    recipe = make_recipe([choose_setup(planned) for planned in plan])
    if recipe.model_fields_set - {"schema_"}:
        text = dumps(recipe.model_dump(mode="json", by_alias=True, exclude_unset=True))
        (folder / "recipe.toml").write_bytes(text.encode("utf-8"))
    table = folder / "scans.csv"
    table.write_bytes(format_scans(scans, folder).encode("utf-8"))
    return table


def write_layers(folder: Path, plan: Sequence[PlannedInsertion]) -> None:
    """Write the stated surfaces of the media in `plan`."""
    for medium in dict.fromkeys(planned.medium for planned in plan):
        for surface in make_surfaces(PHANTOMS[medium]):
            write_surface(surface, folder / surface_file_name(medium, surface))


def render_insertion(
    folder: Path, planned: PlannedInsertion, seed: int, form: VolumeFormat = "nrrd"
) -> RenderedInsertion:
    """Simulate an insertion and write its volume and its markers into `folder`."""
    name, setup = planned.id, choose_setup(planned)
    insertion = simulate_insertion(planned, seed)
    exposure = expose(insertion, setup, seed)
    markers = folder / "markers" / f"{name}.csv"
    markers.parent.mkdir(parents=True, exist_ok=True)
    markers.write_bytes(format_markers(exposure.stated).encode("utf-8"))
    volume = folder / "volumes" / (name if form == "dicom" else f"{name}.nrrd")
    write_volume(acquire(exposure, seed, name), volume, f"Synthetic: needlefit twin ct {name} --seed {seed}")
    return RenderedInsertion(insertion, exposure, make_stated_scan(folder, planned, volume, markers))


def make_recipe(setups: Sequence[ScanSetup]) -> ReconstructionRecord:
    """Return the recipe that states how well the markers' places are known, if not the default."""
    plain = ReconstructionRecord(schema_=ReconstructionRecord.SCHEMA)
    known_sd = max(setup.known_sd for setup in setups)
    if known_sd == plain.markers.reference_sd_mm:
        return plain
    return ReconstructionRecord(
        schema_=ReconstructionRecord.SCHEMA,
        title="Twin",
        needle=ScannedNeedleRecord(name="18 gauge, 150 mm", note="Nominal; solid, its stylet in place."),
        markers=MarkersRecord(reference_sd_mm=known_sd),
    )


def _render_scan(folder: Path, seed: int, form: VolumeFormat, planned: PlannedInsertion) -> Scan:
    return render_insertion(folder, planned, seed, form).scan


def make_stated_scan(folder: Path, planned: PlannedInsertion, volume: Path, markers: Path) -> Scan:
    """Return the stated data of a scan: the plan, not the truth; y of C points to +y of the phantom."""
    sources = (
        LayerSource(folder / surface_file_name(planned.medium, surface), surface.kind, surface.into)
        for surface in make_surfaces(PHANTOMS[planned.medium])
    )
    return Scan(
        id=planned.id,
        volume=volume,
        medium=planned.medium,
        specimen=planned.specimen,
        markers=markers,
        surfaces=tuple(sources),
        stage=StagePose(
            planned.origin, planned.direction, POSE_SHIFT_SD_MM, float(np.radians(POSE_ANGLE_SD_DEG))
        ),
        bevel=planned.side * planned.toward,
        side=planned.side,
        layers=planned.layers,
        layers_alternative=planned.layers_alternative,
        origin="synthetic",
    )
