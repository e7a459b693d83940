"""What the twin's `dataset.toml` states: origin, needle, noise, layers. Nothing of the truth."""

from needlefit.project.records.dataset import (
    CenterlinesRecord,
    DatasetMediumRecord,
    DatasetRecord,
    FrameRecord,
    InsertionsRecord,
    NoiseRecord,
    SurfaceRecord,
)
from needlefit.project.records.scene import NeedleRecord
from needlefit.synthetic.measure import NOISE
from needlefit.synthetic.phantoms import PHANTOMS, Phantom, surface_file, surfaces

BOUNDARY_SD = 0.15
"""Deviation of a measured layer depth, mm: of the boundary's own place, and of the centreline there."""

NOTES = (
    "Synthetic: no needle was ever inserted. Counts of insertions, layers traversed and ends of the depth "
    "ranges are the paper's; the layers' places, entry positions, tilts, bevel sides and the depths in "
    "between are invented. The world's x axis points into the 80 mm box, whose entry face is x = 0, "
    "-40 <= y, z <= 40. Entry poses are those of the stage; bevel_x, bevel_y, bevel_z is the direction in "
    "which +y of the constraint frame points, bevel_side the side to which the bevel faces. Centrelines "
    "carry the registration's error, correlated and independent noise; pose_angle_sd_deg is of stage and "
    "registration together, pose_shift_sd_mm of the stage alone. The insertion with layers_alternative = 3 "
    "beside layers = 4 ends at the top of the cylinder. What generated the data is not the model that is "
    "fitted to it."
)

_LAYERS = {
    "phantom1": "Four planar layers, of which the insertions reach three.",
    "phantom2": "Two planar interfaces and, as layer 4, a cylinder lying along y.",
    "phantom3": "Two planar interfaces and, as layer 4, a cylinder lying along y.",
    "chicken": "One layer, three pieces; the third was turned after three insertions.",
}


def statement(seed: int) -> DatasetRecord:
    """Return the record of the twin built with `seed`, its checksums still empty."""
    return DatasetRecord(
        schema_=1,
        name="twin",
        title="Synthetic twin of the paper's 47 insertions",
        origin="synthetic",
        license="CC0-1.0",
        source=f"needlefit twin build --seed {seed}",
        notes=NOTES,
        frame=FrameRecord(name="world", pose="known"),
        needle=NeedleRecord(
            name="18 gauge, 150 mm",
            length_mm=150.0,
            outer_diameter_mm=1.27,
            youngs_modulus_gpa=80.0,
            note="Nominal; solid, its stylet in place.",
        ),
        noise=NoiseRecord(
            registration_mean_mm=NOISE.registration_mean,
            point_sd_mm=NOISE.point_sd,
            correlated_sd_mm=NOISE.correlated_sd,
            correlation_length_mm=NOISE.correlation_length,
        ),
        insertions=InsertionsRecord(file="insertions.csv"),
        centerlines=CenterlinesRecord(pattern="centerlines/{id}.csv"),
        media={name: _medium(name, phantom) for name, phantom in PHANTOMS.items()},
    )


def _medium(name: str, phantom: Phantom) -> DatasetMediumRecord:
    records = tuple(
        SurfaceRecord(file=surface_file(name, surface), kind=surface.kind, into=surface.into)
        for surface in surfaces(phantom)
    )
    return DatasetMediumRecord(surfaces=records, note=_LAYERS[name])
