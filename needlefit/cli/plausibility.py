"""Values of a scene that the model takes and no needle or tissue has: most likely another unit was meant."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from needlefit.project.records.scene import SceneRecord

STIFFEST_GPA = 1000.0
"""Young's modulus of a needle: steel has about 200 GPa, diamond about 1000."""
SOFTEST_PA, HARDEST_PA = 100.0, 1e10
"""Foundation modulus of a tissue."""
SHARPEST = 2.0
"""Offset of the cut per mm: a tip that turns by 63 degrees in one."""


def doubts(scene: "SceneRecord") -> Iterator[str]:
    """Yield a sentence for each value that is hard to believe."""
    modulus = scene.needle.youngs_modulus_gpa
    if modulus is not None and modulus > STIFFEST_GPA:
        yield f"`needle.youngs_modulus_gpa` is {modulus:g}, more than any material has: is it GPa?"
    for n, layer in enumerate(scene.layers, start=1):
        if not SOFTEST_PA <= layer.mu_pa <= HARDEST_PA:
            amount = "little" if layer.mu_pa < SOFTEST_PA else "much"
            yield f"`layers.{n}.mu_pa` is {layer.mu_pa:g}, very {amount} for a tissue: is it Pa?"
    offsets = [("bevel", scene.bevel.offset_mm)]
    offsets += [(f"steps.{n}", step.offset_mm or 0.0) for n, step in enumerate(scene.steps, start=1)]
    spacing = scene.rules.constraint_spacing_mm
    for key, offset in offsets:
        if offset > SHARPEST * spacing:
            yield f"`{key}.offset_mm` is {offset:g} per {spacing:g} mm of depth, a very sharp turn: is it mm?"
