"""Values that can be computed with and that are doubtful: most likely another unit was meant.

No needle or tissue has them, or they make an insertion coarse. Each is judged beside another length of the
same file, so that a small needle is no suspicious one.
"""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

from needlefit.project.records.medium import MediumRecord
from needlefit.project.records.scene import NeedleRecord, SceneRecord
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml_lines import place_of

DIAMETER_TO_LENGTH = (1e-3, 0.05)
"""Of a needle, least and most: 0.2 mm of 200, 3 mm of 60."""
RIGIDITY_NMM2 = (1.0, 2e6)
"""EI, least and most: a nitinol wire of 0.15 mm has 2, a steel rod of 3 mm 800 000."""
MODULUS_GPA = (0.5, 1000.0)
"""Young's modulus of a needle: polymers have 1 to 5, nitinol 40 to 80, steel 200, tungsten carbide 700."""
MU_PA = (100.0, 1e10)
"""Foundation modulus of a tissue, least and most."""
SHARPEST_OFFSET = 2.0
"""Offset of the cut per mm: a tip that turns by 63 degrees in one."""
BOUNDARY_TO_DEPTH = 2e-3
"""Depth of the first boundary over that of the insertion: a skin of 0.1 mm before 50 mm."""

LENGTH_UNITS = {"metres": 1e3, "inches": 25.4, "centimetres": 10.0}

GAUGES_MM = {
    **{10: 3.404, 11: 3.048, 12: 2.769, 13: 2.413, 14: 2.108, 15: 1.829, 16: 1.651, 17: 1.473, 18: 1.270},
    **{19: 1.067, 20: 0.908, 21: 0.819, 22: 0.718, 23: 0.642, 24: 0.566, 25: 0.515, 26: 0.464, 27: 0.413},
    **{28: 0.362, 29: 0.337, 30: 0.312, 31: 0.261, 32: 0.235, 33: 0.210, 34: 0.184},
}
"""Outer diameters of needles by their gauge."""

FEWEST_CELLS = 5
"""Constraint cells of an insertion: its tip's way is made of as many straight cuts."""

KIND = "units"

Where = Callable[[str], str]
"""The key of a value -> file and line."""


def where_in(file: Path | str) -> Where:
    """Return what names a key's place: the line of a file, or a text as it is, such as a recording's name."""
    path = Path(file)
    return lambda key: place_of(path, key) if path.is_file() else str(file)


def needle_warnings(needle: NeedleRecord, where: Where, key: str = "needle") -> Iterator[ResultWarning]:
    """Yield a warning for each value of a needle that is hard to believe."""
    diameter, rigidity = needle.outer_diameter_mm, needle.flexural_rigidity_nmm2
    modulus = needle.youngs_modulus_gpa
    if diameter is not None:
        yield from _diameter_warnings(diameter, needle.length_mm, where, f"{key}.outer_diameter_mm")
    if modulus is not None and not MODULUS_GPA[0] <= modulus <= MODULUS_GPA[1]:
        name = f"{key}.youngs_modulus_gpa"
        what = f"`{name}` is {modulus:g}, and needles have {MODULUS_GPA[0]:g} to {MODULUS_GPA[1]:g}"
        yield ResultWarning(KIND, what, where(name), "write it in GPa: about 200 for steel")
    if rigidity is not None:
        yield from _rigidity_warnings(rigidity, diameter, where, f"{key}.flexural_rigidity_nmm2")


def _diameter_warnings(diameter: float, length: float, where: Where, key: str) -> Iterator[ResultWarning]:
    ratio = diameter / length
    if DIAMETER_TO_LENGTH[0] <= ratio <= DIAMETER_TO_LENGTH[1] or length < 1.0:  # a length in metres
        return
    what = f"`{key}` is {diameter:g} on a needle of {length:g} mm"
    if ratio < DIAMETER_TO_LENGTH[0]:
        unit, factor = min(LENGTH_UNITS.items(), key=lambda one: abs(math.log(one[1] * diameter)))
        yield ResultWarning(
            KIND, f"{what}: this looks like {unit}", where(key), f"write {factor * diameter:g}"
        )
    elif diameter in GAUGES_MM:
        gauge = GAUGES_MM[int(diameter)]
        what += f": this looks like a gauge, and {diameter:g} gauge is {gauge:g} mm"
        yield ResultWarning(KIND, what, where(key), f"write {gauge:g}")
    else:
        yield ResultWarning(KIND, f"{what}, very thick", where(key), "check both, in mm")


def _rigidity_warnings(
    rigidity: float, diameter: float | None, where: Where, key: str
) -> Iterator[ResultWarning]:
    if not RIGIDITY_NMM2[0] <= rigidity <= RIGIDITY_NMM2[1]:
        what = f"`{key}` is {rigidity:g}, and needles have {RIGIDITY_NMM2[0]:g} to {RIGIDITY_NMM2[1]:g}"
        in_nm2 = RIGIDITY_NMM2[0] <= rigidity * 1e6 <= RIGIDITY_NMM2[1]
        fix = f"if it is in N m^2, write {1e6 * rigidity:g}" if in_nm2 else "write it in N mm^2"
        yield ResultWarning(KIND, what, where(key), fix)
    elif diameter is not None:
        modulus = 1e-3 * rigidity / (math.pi * diameter**4 / 64)  # of a solid rod, the least there can be
        if not modulus <= MODULUS_GPA[1]:
            what = (
                f"`{key}` is {rigidity:g}: a rod of {diameter:g} mm then has a modulus of {modulus:.3g} GPa"
            )
            yield ResultWarning(KIND, what, where(key), "check rigidity and diameter")


def scene_warnings(scene: SceneRecord, file: Path | str = "") -> Iterator[ResultWarning]:
    """Yield a warning for each value of a scene that is hard to believe; `file` is named as its place."""
    where = where_in(file)
    yield from needle_warnings(scene.needle, where)
    for n, layer in enumerate(scene.layers, start=1):
        yield from _mu_warnings(layer.mu_pa, where, f"layers.{n}.mu_pa")
    tops = [layer.top_mm for layer in scene.layers[1:]]
    if tops:
        yield from boundary_warnings(tops[0], _deepest(scene), where, "layers.2.top_mm")
    offsets = [("bevel", scene.bevel.offset_mm)]
    offsets += [(f"steps.{n}", step.offset_mm or 0.0) for n, step in enumerate(scene.steps, start=1)]
    spacing = scene.rules.constraint_spacing_mm
    for key, offset in offsets:
        if offset > SHARPEST_OFFSET * spacing:
            name = f"{key}.offset_mm"
            what = f"`{name}` is {offset:g} per {spacing:g} mm of depth, a very sharp turn"
            yield ResultWarning(KIND, what, where(name), "write it in mm")


def coarse_warnings(scene: SceneRecord, file: Path | str = "") -> Iterator[ResultWarning]:
    """Yield a warning if the deepest insertion of a scene has few constraint cells; kind `coarse`.

    Of a scene that is simulated; one that is predicted has the constraint spacing of its medium.
    """
    spacing, deepest = scene.rules.constraint_spacing_mm, _deepest(scene)
    cells = math.ceil(deepest / spacing - 1e-9)
    if 0 < cells < FEWEST_CELLS:
        key = "rules.constraint_spacing_mm"
        what = f"`{key}` is {spacing:g}: an insertion of {deepest:g} mm has only {cells} constraint cells"
        fix = f"take {FEWEST_CELLS} or more, and the bevel offset for that spacing"
        yield ResultWarning("coarse", what, where_in(file)(key), fix)


def _deepest(scene: SceneRecord) -> float:
    return max((step.depth_mm for step in scene.steps), default=scene.depth_mm or 0.0)


def medium_warnings(medium: MediumRecord, file: Path) -> Iterator[ResultWarning]:
    """Yield a warning for each modulus of a medium that is fixed, or bounded, far from any tissue's."""
    where = where_in(file)
    for name, parameter in medium.parameters.items():
        if not name.startswith("mu"):
            continue
        if parameter.fixed is not None:
            yield from _mu_warnings(parameter.fixed, where, f"parameters.{name}")
        elif parameter.bounds is not None and parameter.bounds[1] < MU_PA[0]:
            yield from _mu_warnings(parameter.bounds[1], where, f"parameters.{name}")


def _mu_warnings(mu: float, where: Where, key: str) -> Iterator[ResultWarning]:
    if not MU_PA[0] <= mu <= MU_PA[1]:
        what = f"`{key}` is {mu:g}, very {'little' if mu < MU_PA[0] else 'much'} for a tissue"
        yield ResultWarning(KIND, what, where(key), "write it in Pa")


def boundary_warnings(first: float, depth: float, where: Where, key: str) -> Iterator[ResultWarning]:
    """Yield a warning if the first boundary is very shallow beside the `depth` of insertions, mm."""
    if 0 < first < BOUNDARY_TO_DEPTH * depth:
        what = f"`{key}` has a boundary at {first:g} mm before insertions of {depth:g} mm"
        metres = BOUNDARY_TO_DEPTH * depth <= 1e3 * first <= 2 * depth
        looks = ": this looks like metres" if metres else ""
        fix = f"write {1e3 * first:g}" if metres else "check it, in mm"
        yield ResultWarning(KIND, what + looks, where(key), fix)
