"""Values that can be computed with and that no needle or tissue has: most likely another unit was meant."""

from collections.abc import Iterator

from needlefit.project.records.scene import SceneRecord
from needlefit.project.result_warnings import ResultWarning

STIFFEST_GPA = 1000.0
"""Young's modulus of a needle: steel has about 200 GPa, tungsten carbide 700, diamond about 1000."""
MU_PA = (100.0, 1e10)
"""Foundation modulus of a tissue, least and most."""
SHARPEST_OFFSET = 2.0
"""Offset of the cut per mm: a tip that turns by 63 degrees in one."""

KIND = "units"


def unit_warnings(scene: SceneRecord, where: str = "") -> Iterator[ResultWarning]:
    """Yield a warning for each value of a scene that is hard to believe; `where` is its file."""
    modulus = scene.needle.youngs_modulus_gpa
    if modulus is not None and modulus > STIFFEST_GPA:
        what = f"`needle.youngs_modulus_gpa` is {modulus:g}, more than any material has"
        yield ResultWarning(KIND, what, where, "write it in GPa")
    for n, layer in enumerate(scene.layers, start=1):
        if not MU_PA[0] <= layer.mu_pa <= MU_PA[1]:
            amount = "little" if layer.mu_pa < MU_PA[0] else "much"
            what = f"`layers.{n}.mu_pa` is {layer.mu_pa:g}, very {amount} for a tissue"
            yield ResultWarning(KIND, what, where, "write it in Pa")
    offsets = [("bevel", scene.bevel.offset_mm)]
    offsets += [(f"steps.{n}", step.offset_mm or 0.0) for n, step in enumerate(scene.steps, start=1)]
    spacing = scene.rules.constraint_spacing_mm
    for key, offset in offsets:
        if offset > SHARPEST_OFFSET * spacing:
            what = f"`{key}.offset_mm` is {offset:g} per {spacing:g} mm of depth, a very sharp turn"
            yield ResultWarning(KIND, what, where, "write it in mm")
