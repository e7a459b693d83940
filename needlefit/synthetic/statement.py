"""What the twin's `dataset.toml` states: where it comes from, and its media. Nothing of the truth."""

from needlefit.imaging.assemble import About

NOTES = (
    "Synthetic: no needle was ever inserted. Counts of insertions, layers traversed and ends of the depth "
    "ranges are the paper's; the layers' places, entry positions, tilts, bevel sides and the depths in "
    "between are invented. The world's x axis points into the 80 mm box, whose entry face is x = 0, "
    "-40 <= y, z <= 40. Entry poses are those of the stage; bevel_x, bevel_y, bevel_z is the direction in "
    "which +y of the constraint frame points, bevel_side the side to which the bevel faces. Every insertion "
    "was rendered as a cone-beam CT volume (voxels of 0.46 mm; partial volume, point spread, noise, bloom, "
    "streaks, beam hardening) and reconstructed from it as a measured scan would be: centreline and tip from "
    "the voxels, eight balls registered to their stated places, layers from their stated surfaces. "
    "`needlefit twin ct` writes the volumes. The insertion with layers_alternative = 3 beside layers = 4 "
    "ends at the top of the cylinder. What generated the data is not the model that is fitted to it."
)

_LAYERS = {
    "phantom1": "Four planar layers, of which the insertions reach three.",
    "phantom2": "Two planar interfaces and, as layer 4, a cylinder lying along y.",
    "phantom3": "Two planar interfaces and, as layer 4, a cylinder lying along y.",
    "chicken": "One layer, three pieces; the third was turned after three insertions.",
}


def statement(seed: int, more: str = "") -> About:
    """Return what the twin built with `seed` states of itself, and `more` if it departs from that."""
    return About(
        name="twin",
        title="Synthetic twin of the paper's 47 insertions",
        license="CC0-1.0",
        source=f"needlefit twin build --seed {seed}",
        notes=NOTES + more,
        media=_LAYERS,
    )
