"""The twin as scans: each insertion rendered as a CT volume, in a folder for `needlefit reconstruct`."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from needlefit.datasets.formats.toml import dumps
from needlefit.geometry.surfaces import write_surface
from needlefit.imaging.scan import LayerSource, Scan, Stage
from needlefit.imaging.volume import write
from needlefit.project.processes import in_order
from needlefit.project.records.reconstruction import MarkersRecord, ReconstructionRecord, ScannedNeedleRecord
from needlefit.project.threads import one_thread
from needlefit.project.watching import Progress
from needlefit.synthetic.ct.insertion import Exposure, acquire, expose
from needlefit.synthetic.ct.setup import Setup, setup_of
from needlefit.synthetic.design import Planned
from needlefit.synthetic.phantoms import PHANTOMS, surface_file, surfaces
from needlefit.synthetic.scans_table import markers_text, scans_text
from needlefit.synthetic.truth import POSE_ANGLE_SD, POSE_SHIFT_SD
from needlefit.synthetic.twin import Twin, synthesize

Form = Literal["nrrd", "dicom"]


@dataclass(frozen=True)
class Scanned:
    """An insertion, how it was scanned, and what a user would be given of it."""

    twin: Twin
    exposure: Exposure
    scan: Scan


@one_thread
def write_scans(
    folder: Path, plan: Sequence[Planned], seed: int, form: Form, jobs: int, progress: Progress
) -> Path:
    """Render `plan` into the empty `folder`; return its `scans.csv`. The same seed gives the same bytes.

    Parameters
    ----------
    progress : callable
        Told what is being done, how many insertions are done, and of how many.
    """
    write_layers(folder, plan)
    scans = []
    progress("rendering", 0, len(plan))
    for done in in_order(partial(_rendered, folder, seed, form), plan, jobs):
        scans.append(done)
        progress(f"rendered {done.id}", len(scans), len(plan))
    recipe = recipe_of([setup_of(planned) for planned in plan])
    if recipe.model_fields_set - {"schema_"}:
        text = dumps(recipe.model_dump(mode="json", by_alias=True, exclude_unset=True))
        (folder / "recipe.toml").write_bytes(text.encode("utf-8"))
    table = folder / "scans.csv"
    table.write_bytes(scans_text(scans, folder).encode("utf-8"))
    return table


def write_layers(folder: Path, plan: Sequence[Planned]) -> None:
    """Write the stated surfaces of the media in `plan`."""
    for medium in dict.fromkeys(planned.medium for planned in plan):
        for surface in surfaces(PHANTOMS[medium]):
            write_surface(surface, folder / surface_file(medium, surface))


def render_insertion(folder: Path, planned: Planned, seed: int, form: Form = "nrrd") -> Scanned:
    """Simulate an insertion and write its volume and its markers into `folder`."""
    name, setup = planned.id, setup_of(planned)
    twin = synthesize(planned, seed)
    exposure = expose(twin, setup, seed)
    markers = folder / "markers" / f"{name}.csv"
    markers.parent.mkdir(parents=True, exist_ok=True)
    markers.write_bytes(markers_text(exposure.stated).encode("utf-8"))
    volume = folder / "volumes" / (name if form == "dicom" else f"{name}.nrrd")
    write(acquire(exposure, seed, name), volume, f"Synthetic: needlefit twin ct {name} --seed {seed}")
    return Scanned(twin, exposure, as_given(folder, planned, volume, markers))


def recipe_of(setups: Sequence[Setup]) -> ReconstructionRecord:
    """Return the recipe that states how well the markers' places are known; else the default one."""
    plain = ReconstructionRecord(schema_=1)
    known_sd = max(setup.known_sd for setup in setups)
    if known_sd == plain.markers.known_sd_mm:
        return plain
    return ReconstructionRecord(
        schema_=1,
        title="Twin",
        needle=ScannedNeedleRecord(name="18 gauge, 150 mm", note="Nominal; solid, its stylet in place."),
        markers=MarkersRecord(known_sd_mm=known_sd),
    )


def _rendered(folder: Path, seed: int, form: Form, planned: Planned) -> Scan:
    return render_insertion(folder, planned, seed, form).scan


def as_given(folder: Path, planned: Planned, volume: Path, markers: Path) -> Scan:
    """Return what is stated of a scan: the plan, not the truth; y of C points to +y of the phantom."""
    sources = (
        LayerSource(folder / surface_file(planned.medium, surface), surface.kind, surface.into)
        for surface in surfaces(PHANTOMS[planned.medium])
    )
    return Scan(
        id=planned.id,
        volume=volume,
        medium=planned.medium,
        specimen=planned.specimen,
        markers=markers,
        surfaces=tuple(sources),
        stage=Stage(planned.origin, planned.direction, POSE_SHIFT_SD, float(np.radians(POSE_ANGLE_SD))),
        bevel=planned.side * planned.toward,
        side=planned.side,
        layers=planned.layers,
        layers_alternative=planned.layers_alternative,
        origin="synthetic",
    )
