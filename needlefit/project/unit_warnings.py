"""Values that can be computed with and that are doubtful: most likely another unit was meant.

No needle or tissue has them, or they make an insertion coarse. Each is judged beside another length of the
same file, so that a small needle is no suspicious one.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml_lines import locate_key
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.scene import NeedleRecord, SceneRecord

DIAMETER_TO_LENGTH = (1e-3, 0.05)
"""Of a needle, least and most: 0.2 mm of 200, 3 mm of 60."""
RIGIDITY_NMM2 = (1.0, 2e6)
"""EI, least and most: a nitinol wire of 0.15 mm has 2, a steel rod of 3 mm 800 000."""
MODULUS_GPA = (0.5, 1000.0)
"""Young's modulus of a needle: polymers have 1 to 5, nitinol 40 to 80, steel 200, tungsten carbide 700."""
MU_PA = (300.0, 1e10)
"""Foundation modulus of a tissue, least and most. Among the softest organs are brain, 842 Pa (Miller and
Chinzei 2002, J Biomech 35, 483), and fat, a Young's modulus of about 1 kPa, a third of which is mu."""
MU_UNITS = {"kPa": 1e3, "MPa": 1e6}
"""Pascals in each."""
ALPHA = (0.05, 60.0)
"""Size of an Ogden exponent, least and most: W divides by its square, and at 0 the law is of another form.
The paper has 0.2 to 1; brain has -4.7 (Miller and Chinzei 2002), fat about 20."""
OFFSET_TO_SPACING = (1e-3, 2.0)
"""Offset of the cut per mm, least and most: the paper has 0.03 to 0.085; at 2 the tip turns by 63 degrees in
one. 0 is a needle without a bevel."""
CUT_ANGLE_DEG = (0.2, 45.0)
"""Angle of the cut, least and most: an offset of 0.0035 per mm is 0.2 degrees."""
ANGLE_UNITS = {"radians": math.degrees(1)}
"""Degrees in each."""
CUT_ANGLES = (CUT_ANGLE_DEG, ANGLE_UNITS)
ANGLE_SD_DEG = (0.02, 20.0)
"""Standard deviation of a measured direction, least and most: 0.02 mm over 60 mm are 0.02 degrees."""
BOUNDARY_TO_DEPTH = 2e-3
"""Thickness of a layer over the depth of the insertion: a skin of 0.1 mm before 50 mm."""
BOUNDARIES_TO_DEPTH = 0.1
"""Depth of the last of several boundaries over that of the deepest insertion."""

LENGTH_UNITS = {"metres": 1e3, "inches": 25.4, "centimetres": 10.0, "micrometres": 1e-3}
"""Millimetres in each."""

MODULUS_UNITS = {"Pa": 1e-9, "MPa": 1e-3, "kPa": 1e-6, "psi": 6.894757e-6, "ksi": 6.894757e-3}
"""Gigapascals in each."""

METAL_GPA = (25.0, 700.0)
"""Young's modulus of a metal needle: martensitic nitinol has 28, tungsten carbide 700."""

STEEL_GPA = 200.0

TYPICAL_GPA = (3.0, 40.0, 75.0, 110.0, STEEL_GPA)
"""Young's moduli of a polymer, nitinol (martensite, austenite), titanium, steel."""

DIAMETER_MM = (0.15, 5.0)
"""Outer diameter of a needle, least and most: 34 gauge has 0.18, 10 gauge 3.4."""

MIN_INNER_DIAMETER_MM = 0.05
"""Inner diameter of a tube: 34 gauge has 0.08."""

MIN_WALL_TO_DIAMETER = 0.03
"""Wall of a tube over its outer diameter; ultra-thin walls have 0.08."""

GAUGES_MM = {
    **{10: 3.404, 11: 3.048, 12: 2.769, 13: 2.413, 14: 2.108, 15: 1.829, 16: 1.651, 17: 1.473, 18: 1.270},
    **{19: 1.067, 20: 0.908, 21: 0.819, 22: 0.718, 23: 0.642, 24: 0.566, 25: 0.515, 26: 0.464, 27: 0.413},
    **{28: 0.362, 29: 0.337, 30: 0.312, 31: 0.261, 32: 0.235, 33: 0.210, 34: 0.184},
}
"""Outer diameters of needles by their gauge."""

MIN_CELLS = 5
"""Constraint cells of an insertion: its tip's way is made of as many straight cuts."""

WARNING_KIND = "units"

FormatPlace = Callable[[str], str]
"""The key of a value -> file and line."""


def format_place(file: Path | str) -> FormatPlace:
    """Return what names a key's place: the line of a file, or a text as it is, such as a recording's name."""
    path = Path(file)
    return lambda key: locate_key(path, key) if path.is_file() else str(file)


def needle_warnings(needle: NeedleRecord, where: FormatPlace, key: str = "needle") -> Iterator[ResultWarning]:
    """Yield a warning for each value of a needle that is hard to believe."""
    diameter, rigidity = needle.outer_diameter_mm, needle.flexural_rigidity_nmm2
    modulus = needle.youngs_modulus_gpa
    if diameter is not None:
        yield from _diameter_warnings(diameter, needle.length_mm, where, key)
        yield from _wall_warnings(needle.inner_diameter_mm, diameter, where, f"{key}.inner_diameter_mm")
    if modulus is not None and not MODULUS_GPA[0] <= modulus <= MODULUS_GPA[1]:
        yield _modulus_warning(modulus, where, f"{key}.youngs_modulus_gpa")
    if rigidity is not None:
        yield from _rigidity_warnings(rigidity, diameter, where, f"{key}.flexural_rigidity_nmm2")
    if rigidity is not None and diameter is None:
        yield from _stubby_warnings(rigidity, needle.length_mm, where, f"{key}.length_mm")


def _stubby_warnings(rigidity: float, length: float, where: FormatPlace, key: str) -> Iterator[ResultWarning]:
    """Yield a warning if a needle is too short for its rigidity; a length in metres is a fault."""
    rod = (64e-3 * rigidity / (math.pi * STEEL_GPA)) ** 0.25  # no steel needle is thinner
    if length >= 1.0 and rod > DIAMETER_TO_LENGTH[1] * length and rigidity <= RIGIDITY_NMM2[1]:
        what = f"short for a flexural rigidity of {rigidity:g}, which a steel rod of {rod:.2g} mm has"
        yield _length_warning(length, rod, what, where, key)


def _diameter_warnings(
    diameter: float, length: float, where: FormatPlace, table: str
) -> Iterator[ResultWarning]:
    """Yield a warning if a diameter, or a length beside it, is no needle's; both may be in another unit."""
    key, ratio = f"{table}.outer_diameter_mm", diameter / length
    if length < 1.0:  # a length in metres is a fault
        return
    what = f"`{key}` is {diameter:g} on a needle of {length:g} mm"
    if not DIAMETER_MM[0] <= diameter <= DIAMETER_MM[1]:
        looks, fix = _likely_diameter(diameter, length)
        yield ResultWarning(WARNING_KIND, what + looks, where(key), fix)
    elif ratio < DIAMETER_TO_LENGTH[0]:
        yield _length_warning(length, diameter, what, where, f"{table}.length_mm")
    elif ratio > DIAMETER_TO_LENGTH[1]:
        yield _length_warning(length, diameter, f"{what}, very thick", where, f"{table}.length_mm")


def _likely_diameter(diameter: float, length: float) -> tuple[str, str]:
    """Return the likely unit of a diameter that no needle has, in words, and what to write instead."""
    if diameter in GAUGES_MM:
        gauge = GAUGES_MM[int(diameter)]
        return f": this looks like a gauge, and {diameter:g} gauge is {gauge:g} mm", f"write {gauge:g}"
    likely = {
        unit: factor
        for unit, factor in LENGTH_UNITS.items()
        if DIAMETER_MM[0] <= factor * diameter <= DIAMETER_MM[1]
    }
    if not likely:
        return "", "check it, in mm"
    unit = min(likely, key=lambda one: _log_distance(likely[one] * diameter, GAUGES_MM.values()))
    fix = f"write {likely[unit] * diameter:g}"
    # where its ratio to the length is a needle's, the length is in the same unit
    same = DIAMETER_TO_LENGTH[0] <= diameter / length <= DIAMETER_TO_LENGTH[1]
    alone = DIAMETER_TO_LENGTH[0] <= likely[unit] * diameter / length <= DIAMETER_TO_LENGTH[1]
    if same and not alone:
        fix += f", {likely[unit] * length:g} for the length, and check every other length"
    return f": this looks like {unit}", fix


def _log_distance(value: float, usual: Iterable[float]) -> float:
    """Return how far a value is from the nearest usual one, as a logarithm of their ratio."""
    return min(abs(math.log(value / one)) for one in usual)


def _length_warning(length: float, diameter: float, what: str, where: FormatPlace, key: str) -> ResultWarning:
    """Return the warning that a needle of such a diameter, mm, has no such length."""
    likely = [
        f"{factor * length:g} if it is in {unit}"
        for unit, factor in LENGTH_UNITS.items()
        if unit != "metres" and DIAMETER_TO_LENGTH[0] <= diameter / (factor * length) <= DIAMETER_TO_LENGTH[1]
    ]
    what = what if f"`{key}`" in what else f"`{key}` is {length:g}: {what}"
    return ResultWarning(
        WARNING_KIND, what, where(key), f"write {', '.join(likely)}" if likely else "check both, in mm"
    )


def _wall_warnings(inner: float, outer: float, where: FormatPlace, key: str) -> Iterator[ResultWarning]:
    what = f"`{key}` is {inner:g} in a tube of {outer:g} mm"
    if 0 < inner < min(MIN_INNER_DIAMETER_MM, outer):
        yield ResultWarning(
            WARNING_KIND, f"{what}, less than any tube has", where(key), "check it, in mm; 0 if solid"
        )
    wall = 0.5 * (outer - inner)
    if wall < MIN_WALL_TO_DIAMETER * outer:
        what += f", which leaves a wall of {wall:.2g} mm"
        yield ResultWarning(WARNING_KIND, what, where(key), "check both diameters, in mm; 0 if solid")


def _modulus_warning(modulus: float, where: FormatPlace, key: str) -> ResultWarning:
    what = f"`{key}` is {modulus:g}, and needles have {MODULUS_GPA[0]:g} to {MODULUS_GPA[1]:g}"
    unit, in_gpa = likely_modulus(modulus)
    if unit:
        return ResultWarning(
            WARNING_KIND, f"{what}: this looks like {unit}", where(key), f"write {in_gpa:.3g}"
        )
    return ResultWarning(WARNING_KIND, what, where(key), "write it in GPa: about 200 for steel")


def likely_modulus(modulus: float) -> tuple[str, float]:
    """Return the likely unit of a modulus that no needle has in GPa, and its value in GPa; "" if none is."""
    for least, most in (METAL_GPA, MODULUS_GPA):
        likely = {
            unit: modulus * factor
            for unit, factor in MODULUS_UNITS.items()
            if least <= modulus * factor <= most
        }
        if likely:
            unit = min(likely, key=lambda one: _log_distance(likely[one], TYPICAL_GPA))
            return unit, likely[unit]
    return "", math.nan


def _rigidity_warnings(
    rigidity: float, diameter: float | None, where: FormatPlace, key: str
) -> Iterator[ResultWarning]:
    if not RIGIDITY_NMM2[0] <= rigidity <= RIGIDITY_NMM2[1]:
        what = f"`{key}` is {rigidity:g}, and needles have {RIGIDITY_NMM2[0]:g} to {RIGIDITY_NMM2[1]:g}"
        in_nm2 = RIGIDITY_NMM2[0] <= rigidity * 1e6 <= RIGIDITY_NMM2[1]
        fix = f"if it is in N m^2, write {1e6 * rigidity:g}" if in_nm2 else "write it in N mm^2"
        yield ResultWarning(WARNING_KIND, what, where(key), fix)
    elif diameter is not None:
        modulus = 1e-3 * rigidity / (math.pi * diameter**4 / 64)  # of a solid rod, the least there can be
        if not modulus <= MODULUS_GPA[1]:
            what = (
                f"`{key}` is {rigidity:g}: a rod of {diameter:g} mm then has a modulus of {modulus:.3g} GPa"
            )
            yield ResultWarning(WARNING_KIND, what, where(key), "check rigidity and diameter")


def scene_warnings(scene: SceneRecord, file: Path | str = "") -> Iterator[ResultWarning]:
    """Yield a warning for each value of a scene that is hard to believe; `file` is named as its place."""
    where = format_place(file)
    yield from needle_warnings(scene.needle, where)
    for n, layer in enumerate(scene.layers, start=1):
        yield from range_warnings(layer.mu_pa, MU_PA, MU_UNITS, where, f"layers.{n}.mu_pa", "Pa")
        if layer.alpha is not None:
            yield from _alpha_warnings(layer.alpha, scene.law, where, f"layers.{n}.alpha")
    tops = [layer.top_mm for layer in scene.layers[1:]]
    if tops:
        yield from boundary_warnings(tops[0], _deepest(scene), where, "layers.2.top_mm")
    spacing = scene.rules.constraint_spacing_mm
    bevels = [("bevel", scene.bevel.offset_mm, scene.bevel.cut_angle_deg)]
    bevels += [(f"steps.{n}", one.offset_mm, one.cut_angle_deg) for n, one in enumerate(scene.steps, start=1)]
    for key, offset, angle in bevels:
        yield from _offset_warnings(offset, spacing, where, f"{key}.offset_mm")
        if angle:
            yield from range_warnings(angle, *CUT_ANGLES, where, f"{key}.cut_angle_deg", "degrees")


def coarse_warnings(scene: SceneRecord, file: Path | str = "") -> Iterator[ResultWarning]:
    """Yield a warning if the deepest insertion of a scene has few constraint cells; kind `coarse`.

    Of a scene that is simulated; one that is predicted has the constraint spacing of its medium.
    """
    spacing, deepest = scene.rules.constraint_spacing_mm, _deepest(scene)
    cells = math.ceil(deepest / spacing - 1e-9)
    if 0 < cells < MIN_CELLS:
        key = "rules.constraint_spacing_mm"
        what = f"`{key}` is {spacing:g}: an insertion of {deepest:g} mm has only {cells} constraint cells"
        fix = f"take {MIN_CELLS} or more, and the bevel offset for that spacing"
        yield ResultWarning("coarse", what, format_place(file)(key), fix)


def _deepest(scene: SceneRecord) -> float:
    return max((step.depth_mm for step in scene.steps), default=scene.depth_mm or 0.0)


def medium_warnings(medium: MediumRecord, file: Path | str) -> Iterator[ResultWarning]:
    """Yield a warning for each parameter of a medium that is fixed at, or bounded by, what no tissue has."""
    where, spacing = format_place(file), medium.constraint_spacing_mm
    for name, parameter in medium.parameters.items():
        key, fixed, bounds = f"parameters.{name}", parameter.fixed, parameter.bounds
        if name.startswith("mu"):
            if fixed is not None:
                yield from range_warnings(fixed, MU_PA, MU_UNITS, where, key, "Pa")
            elif bounds is not None:  # wide ones are no sign of another unit
                yield from range_warnings(bounds[1], (MU_PA[0], math.inf), MU_UNITS, where, key, "Pa")
        elif name.startswith("alpha") and fixed is not None:
            yield from _alpha_warnings(fixed, medium.law, where, key)
        elif name == "bevel_mm":
            yield from _offset_warnings(fixed or (bounds and bounds[1]), spacing, where, key)
        elif name == "cut_angle_deg" and (angle := fixed or (bounds and bounds[1])):
            yield from range_warnings(angle, *CUT_ANGLES, where, key, "degrees")


def range_warnings(
    value: float,
    plausible: tuple[float, float],
    units: Mapping[str, float],
    where: FormatPlace,
    key: str,
    unit: str,
) -> Iterator[ResultWarning]:
    """Yield a warning if a value is out of a range, with the first of other `units` in which it is not."""
    low, high = plausible
    if low <= value <= high:
        return
    likely = next((one for one, factor in units.items() if low <= factor * value <= high), "")
    what = (
        f"`{key}` is {value:g} {unit}, {'below' if value < low else 'above'} {low if value < low else high:g}"
    )
    if likely:
        what, fix = f"{what}: this looks like {likely}", f"write {units[likely] * value:g}"
    else:
        fix = f"check it, in {unit}"
    yield ResultWarning(WARNING_KIND, what, where(key), fix)


def _alpha_warnings(alpha: float, law: str, where: FormatPlace, key: str) -> Iterator[ResultWarning]:
    if law == "ogden" and not ALPHA[0] <= abs(alpha) <= ALPHA[1]:
        what = (
            f"`{key}` is {alpha:g}; Ogden exponents are {ALPHA[0]:g} to {ALPHA[1]:g} in size, of either sign"
        )
        yield ResultWarning(
            WARNING_KIND, what, where(key), "write a fitted exponent, or 1 if it is not known"
        )


def _offset_warnings(
    offset: float | None, spacing: float, where: FormatPlace, key: str
) -> Iterator[ResultWarning]:
    """Yield a warning for a bevel's offset, mm per constraint spacing; 0 is a needle without a bevel."""
    if offset:
        low, high = (spacing * each for each in OFFSET_TO_SPACING)
        yield from range_warnings(
            offset, (low, high), {"metres": 1e3}, where, key, f"mm per {spacing:g} mm of depth"
        )


def boundary_warnings(first: float, depth: float, where: FormatPlace, key: str) -> Iterator[ResultWarning]:
    """Yield a warning if the first boundary is very shallow beside the `depth` of insertions, mm."""
    if 0 < first < BOUNDARY_TO_DEPTH * depth:
        what = f"`{key}` has a boundary at {first:g} mm before insertions of {depth:g} mm"
        metres = BOUNDARY_TO_DEPTH * depth <= 1e3 * first <= 2 * depth
        looks = ": this looks like metres" if metres else ""
        fix = f"write {1e3 * first:g}" if metres else "check it, in mm"
        yield ResultWarning(WARNING_KIND, what + looks, where(key), fix)


def layer_warnings(
    boundaries: Sequence[float], deepest: float, where: FormatPlace, key: str
) -> Iterator[ResultWarning]:
    """Yield a warning for each doubt about the boundaries, mm, of insertions down to `deepest`, mm."""
    if not boundaries:
        return
    shallow = list(boundary_warnings(boundaries[0], deepest, where, key))
    yield from shallow
    what = f"`{key}` is {', '.join(f'{one:g}' for one in boundaries)}"
    if not shallow and len(boundaries) > 1 and boundaries[-1] < BOUNDARIES_TO_DEPTH * deepest:
        what += f", all at the top of insertions of {deepest:g} mm: this looks like centimetres or inches"
        yield ResultWarning(WARNING_KIND, what, where(key), "if so, multiply by 10 or 25.4")
    elif boundaries[-1] >= deepest:
        what += f", and no insertion is deeper than {deepest:g} mm"
        micro = boundaries[0] > deepest > 1e-3 * boundaries[0] > BOUNDARY_TO_DEPTH * deepest
        what += ": this looks like micrometres" if micro else ""
        fix = "divide by 1000" if micro else "check its unit, mm, or leave out what no insertion reaches"
        yield ResultWarning(WARNING_KIND, what, where(key), fix)
    for top, end in pairwise(boundaries):
        if end - top < BOUNDARY_TO_DEPTH * deepest:
            what = f"`{key}` has boundaries at {top:g} and {end:g}, nearly one"
            yield ResultWarning(WARNING_KIND, what, where(key), "remove one of them, or correct it, in mm")
