"""Values that can be computed with and that are doubtful: most likely another unit was meant.

No needle or tissue has them. Each is judged beside another length of the same file, so that a small needle is
no suspicious one.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain, pairwise
from pathlib import Path

from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml import locate_key
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.scene import NeedleRecord, SceneRecord

# length over diameter of a needle, least and most: 60 mm of 3 mm, and 200 mm of 0.2 mm
LENGTH_TO_DIAMETER = (20.0, 1000.0)
# EI (N mm2), least and most: a nitinol wire of 0.15 mm has 2, a steel rod of 3 mm 800 000
RIGIDITY_NMM2 = (1.0, 2e6)
MODULUS_GPA = (0.5, 1000.0)
"""Young's modulus of a needle (GPa), least and most: polymers have 1 to 5, nitinol 40 to 80, steel 200,
tungsten carbide 700."""
NO_MODULUS_GPA = (6.0, 10.0)
"""Moduli (GPa) between the stiffest polymers and the softest composites: no material of needles has them."""
MU_PA = (300.0, 1e8)
"""Foundation modulus of a tissue, least and most. Among the softest organs are brain, 842 Pa (Miller and
Chinzei 2002, J Biomech 35, 483), and fat, a Young's modulus of about 1 kPa, a third of which is mu. The
stiffest layer of the paper has 33 MPa."""
MU_UNITS = {"kPa": 1e3, "MPa": 1e6}  # pascals in each unit of a modulus
ALPHA = (0.05, 60.0)
"""Size of an Ogden exponent, least and most: W divides by its square, and at 0 the law is of another form.
The paper has 0.2 to 1; brain has -4.7 (Miller and Chinzei 2002), fat about 20."""
OFFSET_TO_SPACING = (1e-3, 2.0)
"""Offset of the cut per mm, least and most: the paper has 0.03 to 0.085; at 2 the tip turns by 63 degrees in
one. 0 is a needle without a bevel."""
# angle of the cut (degrees), least and most: an offset of 0.0035 per mm is 0.2 degrees
CUT_ANGLE_DEG = (0.2, 45.0)
ANGLE_UNITS = {"radians": math.degrees(1)}  # degrees in each unit of an angle
CUT_ANGLES = (CUT_ANGLE_DEG, ANGLE_UNITS)
ANGLE_SD_DEG = (0.02, 20.0)
"""SD of a measured direction (degrees), least and most: 0.02 mm over 60 mm are 0.02 degrees."""
BOUNDARY_TO_DEPTH = 2e-3
"""Smallest thickness of the first layer over the depth of the insertion: a skin of 0.1 mm before 50 mm."""
# smallest depth of the last of several boundaries over that of the deepest insertion
BOUNDARIES_TO_DEPTH = 0.1
MIN_DEPTH_MM = 1.0  # smallest depth (mm) of an insertion: a smaller number is likely one in metres
LENGTH_UNITS = {"metres": 1e3, "inches": 25.4, "centimetres": 10.0, "micrometres": 1e-3}
"""Millimetres in each unit of length."""
MICROMETRES_PER_MM = 1e3  # number of micrometres in a millimetre

MODULUS_UNITS = {"Pa": 1e-9, "MPa": 1e-3, "kPa": 1e-6, "psi": 6.894757e-6}
"""Gigapascals in each unit of a modulus."""

DIAMETER_MM = (0.15, 5.0)  # outer diameter of a needle (mm), least and most: 34 gauge has 0.18, 10 gauge 3.4
MIN_INNER_DIAMETER_MM = 0.05  # smallest inner diameter of a tube (mm): 34 gauge has 0.08
MAX_INNER_TO_OUTER = 0.94  # largest inner diameter of a tube over its outer one; ultra-thin walls have 0.84

GAUGES_MM = {
    **{10: 3.404, 11: 3.048, 12: 2.769, 13: 2.413, 14: 2.108, 15: 1.829, 16: 1.651, 17: 1.473, 18: 1.270},
    **{19: 1.067, 20: 0.908, 21: 0.819, 22: 0.718, 23: 0.642, 24: 0.566, 25: 0.515, 26: 0.464, 27: 0.413},
    **{28: 0.362, 29: 0.337, 30: 0.312, 31: 0.261, 32: 0.235, 33: 0.210, 34: 0.184},
}
"""Outer diameters of needles (mm) by their gauge."""
ROUNDED_MM = 1.5e-3
"""Difference (mm) from the diameter of a gauge below which twice a number is that diameter: the number is a
rounded radius."""

# factors on the least and on the greatest fitted depth, between which no prediction is doubted
FITTED_RANGE = (0.5, 1.2)

FormatPlace = Callable[[str], str]  # the key of a value -> file and key
Doubt = tuple[str, str, str]  # a key, what is hard to believe about it, and what to do


def format_place(file: Path | str) -> FormatPlace:
    """Return what names a key's place: of a file, or a text as it is, such as a recording's name."""
    path = Path(file)
    return lambda key: locate_key(path, key) if path.is_file() else str(file)


def warn(doubts: Iterable[Doubt], where: FormatPlace) -> Iterator[ResultWarning]:
    """Yield doubts as warnings that name the places of their keys."""
    return (ResultWarning("units", problem, where(key), fix) for key, problem, fix in doubts)


def needle_warnings(needle: NeedleRecord, where: FormatPlace, key: str = "needle") -> Iterator[ResultWarning]:
    """Yield a warning for each value of a needle, the table `key` of its file, that is hard to believe."""
    return warn(_doubt_needle(needle, key), where)


def scene_warnings(scene: SceneRecord, file: Path | str = "") -> Iterator[ResultWarning]:
    """Yield a warning for each value of a scene that is hard to believe; `file` is named as its place."""
    where = format_place(file)
    return chain(needle_warnings(scene.needle, where), warn(_doubt_scene(scene), where))


def extrapolation_warnings(
    depth: float, fitted: Sequence[float], *, z_unfitted: bool
) -> Iterator[ResultWarning]:
    """Yield a warning if a predicted depth is far from those that were fitted, all in mm.

    `z_unfitted`: another one, as a needle is predicted in space by a fit in one plane.
    """
    if z_unfitted:
        yield ResultWarning(
            kind="extrapolation",
            what="z is predicted, but the needles were fitted in one plane",
            fix='write `compared = "space"` in the study or fit',
        )
    if fitted and not _is_within(depth, (FITTED_RANGE[0] * min(fitted), FITTED_RANGE[1] * max(fitted))):
        ends = dict.fromkeys(f"{end:.3g}" for end in (min(fitted), max(fitted)))
        yield ResultWarning(
            kind="extrapolation",
            what=f"{depth:.4g} mm is no depth that was fitted, {' to '.join(ends)} mm",
            fix="check its unit, mm; intervals contain no model error",
        )


def medium_warnings(medium: MediumRecord, file: Path | str) -> Iterator[ResultWarning]:
    """Yield a warning for each parameter of a medium that is fixed at, or bounded by, what no tissue has."""
    return warn(_doubt_medium(medium), format_place(file))


# ---- needles


def _doubt_needle(needle: NeedleRecord, key: str) -> Iterator[Doubt]:
    outer, inner, length = needle.outer_diameter_mm, needle.inner_diameter_mm, needle.length_mm
    yield from doubt_sizes(
        {f"{key}.length_mm": length, f"{key}.outer_diameter_mm": outer, f"{key}.inner_diameter_mm": inner}
    )
    if (modulus := needle.youngs_modulus_gpa) is not None:
        yield from doubt_modulus(modulus, f"{key}.youngs_modulus_gpa")
    if (rigidity := needle.flexural_rigidity_nmm2) is not None:
        yield from doubt_rigidity(rigidity, f"{key}.flexural_rigidity_nmm2")


def doubt_sizes(sizes: Mapping[str, float | None]) -> Iterator[Doubt]:
    """Yield the doubts about length, outer and inner diameter of a needle, mm, by their keys."""
    (length_key, length), (outer_key, outer), (inner_key, inner) = sizes.items()
    if outer is None or length is None:
        return
    yield from doubt_range(outer, DIAMETER_MM, LENGTH_UNITS, outer_key, "mm")
    if _is_within(outer, DIAMETER_MM):
        lengths = (LENGTH_TO_DIAMETER[0] * outer, LENGTH_TO_DIAMETER[1] * outer)
        yield from doubt_range(length, lengths, LENGTH_UNITS, length_key, "mm")
    for gauge, diameter in GAUGES_MM.items():
        if abs(2 * outer - diameter) < ROUNDED_MM:
            problem = f"`{outer_key}` is {outer:g} mm, half of gauge {gauge}: this looks like a radius"
            yield outer_key, problem, f"check it; the diameter of gauge {gauge} is {diameter:g} mm"
    if inner:
        bores = (min(MIN_INNER_DIAMETER_MM, outer), MAX_INNER_TO_OUTER * outer)
        yield from doubt_range(inner, bores, LENGTH_UNITS, inner_key, "mm")


def doubt_modulus(modulus: float, key: str) -> Iterator[Doubt]:
    """Yield a doubt about Young's modulus of a needle, GPa."""
    yield from doubt_range(modulus, MODULUS_GPA, MODULUS_UNITS, key, "GPa")
    low, high = NO_MODULUS_GPA
    if low < modulus < high:
        problem = (
            f"`{key}` is {modulus:g} GPa: polymers have at most {low:g}, other materials {high:g} or more"
        )
        yield key, problem, "check it, in GPa: PEEK has 3.6, nitinol 40 to 80, steel 200"


def doubt_rigidity(rigidity: float, key: str) -> Iterator[Doubt]:
    """Yield a doubt about a needle's flexural rigidity EI, N mm^2."""
    yield from doubt_range(rigidity, RIGIDITY_NMM2, {"N m^2": 1e6}, key, "N mm^2")


def doubt_depth(depth: float, length: float, key: str) -> Iterator[Doubt]:
    """Yield a doubt about the greatest depth of a needle of a length, both in mm."""
    if depth < MIN_DEPTH_MM and MIN_DEPTH_MM < LENGTH_UNITS["metres"] * depth < length:
        yield from doubt_range(depth, (MIN_DEPTH_MM, math.inf), {"metres": 1e3}, key, "mm")


def doubt_tops(tops: Sequence[float], deepest: float, key: str) -> Iterator[Doubt]:
    """Yield a doubt about the first boundary of a tissue, mm, of an insertion down to `deepest`, mm."""
    if tops:
        shallow = (BOUNDARY_TO_DEPTH * deepest, math.inf)
        yield from doubt_range(tops[0], shallow, {"metres": 1e3}, key, "mm")


def _is_within(value: float, plausible: tuple[float, float]) -> bool:
    return plausible[0] <= value <= plausible[1]


# ---- scenes, media, layers


def _doubt_scene(scene: SceneRecord) -> Iterator[Doubt]:
    for n, layer in enumerate(scene.layers, start=1):
        yield from doubt_mu(layer.mu_pa, f"layers.{n}.mu_pa")
        if layer.alpha is not None:
            yield from doubt_alpha(layer.alpha, scene.law, f"layers.{n}.alpha")
    deepest = max((step.depth_mm for step in scene.steps), default=scene.depth_mm or 0.0)
    yield from doubt_tops([layer.top_mm for layer in scene.layers[1:]], deepest, "layers.2.top_mm")
    yield from doubt_depth(deepest, scene.needle.length_mm, "steps" if scene.steps else "depth_mm")
    bevels = [("bevel", scene.bevel.offset_mm, scene.bevel.cut_angle_deg)]
    bevels += [
        (f"steps.{n}", step.offset_mm, step.cut_angle_deg) for n, step in enumerate(scene.steps, start=1)
    ]
    for key, offset, angle in bevels:
        yield from doubt_offset(offset, scene.rules.constraint_spacing_mm, f"{key}.offset_mm")
        if angle:
            yield from doubt_range(angle, *CUT_ANGLES, f"{key}.cut_angle_deg", "degrees")


def _doubt_medium(medium: MediumRecord) -> Iterator[Doubt]:
    for name, parameter in medium.parameters.items():
        key, fixed, bounds = f"parameters.{name}", parameter.fixed, parameter.bounds
        high = bounds[1] if bounds else None
        if name.startswith("mu"):
            if fixed is not None:
                yield from doubt_range(fixed, MU_PA, MU_UNITS, key, "Pa")
            elif high is not None:  # wide ones are no sign of another unit
                yield from doubt_range(high, (MU_PA[0], math.inf), MU_UNITS, key, "Pa")
        elif name.startswith("alpha") and fixed is not None:
            yield from doubt_alpha(fixed, medium.law, key)
        elif name == "bevel_mm":
            yield from doubt_offset(fixed or high, medium.constraint_spacing_mm, key)
        elif name == "cut_angle_deg" and (angle := fixed or high):
            yield from doubt_range(angle, *CUT_ANGLES, key, "degrees")


def doubt_range(
    value: float, plausible: tuple[float, float], units: Mapping[str, float], key: str, unit: str
) -> Iterator[Doubt]:
    """Yield a doubt if a value is out of a range, with the first of other `units` in which it is not."""
    if _is_within(value, plausible):
        return
    low, high = plausible
    likely = next((unit for unit, factor in units.items() if _is_within(factor * value, plausible)), "")
    beyond = f"below {low:.4g}" if value < low else f"above {high:.4g}"
    looks = f": this looks like {likely}" if likely else ""
    fix = f"write {units[likely] * value:g}" if likely else f"check it, in {unit}"
    yield key, f"`{key}` is {value:g} {unit}, {beyond}{looks}", fix


def doubt_mu(mu: float, key: str) -> Iterator[Doubt]:
    """Yield a doubt about the foundation modulus of a layer, Pa."""
    yield from doubt_range(mu, MU_PA, MU_UNITS, key, "Pa")


def doubt_alpha(alpha: float, law: str, key: str) -> Iterator[Doubt]:
    """Yield a doubt about an exponent of the Ogden law."""
    if law == "ogden" and not _is_within(abs(alpha), ALPHA):
        problem = f"`{key}` is {alpha:g}; exponents are {ALPHA[0]:g} to {ALPHA[1]:g} in size, of either sign"
        yield key, problem, "write a fitted exponent, or 1 if it is not known"


def doubt_offset(offset: float | None, spacing: float, key: str) -> Iterator[Doubt]:
    """Yield a doubt about a bevel's offset, mm per constraint spacing; 0 is a needle without a bevel."""
    if offset:
        low, high = (spacing * ratio for ratio in OFFSET_TO_SPACING)
        yield from doubt_range(offset, (low, high), {"metres": 1e3}, key, f"mm per {spacing:g} mm of depth")


def doubt_layers(boundaries: Sequence[float], deepest: float, key: str) -> Iterator[Doubt]:
    """Yield each doubt about the boundaries, mm, of insertions down to `deepest`, mm.

    The last one is judged; where it is plausible, layers that are hardly there.
    """
    if not boundaries:
        return
    least, units = BOUNDARY_TO_DEPTH * deepest, LENGTH_UNITS
    if len(boundaries) > 1:  # of which centimetres are the likely unit
        least, units = BOUNDARIES_TO_DEPTH * deepest, {"centimetres": 10.0} | LENGTH_UNITS
    last = boundaries[-1]
    if deepest < last < MICROMETRES_PER_MM * BOUNDARIES_TO_DEPTH * deepest:
        units = {}  # a layer that ends so near the entry is no better guess than a slip of a digit
    doubts = list(doubt_range(last, (least, deepest), units, key, "mm"))
    unmet = f"; no needle reaches layer {len(boundaries) + 1}" if last > deepest else ""
    yield from ((key, f"{problem}{unmet}", fix) for key, problem, fix in doubts)
    for top, end in () if doubts else pairwise((0.0, *boundaries)):
        if end - top < BOUNDARY_TO_DEPTH * deepest:
            problem = f"`{key}` has boundaries at {top:g} and {end:g}, nearly one"
            yield key, problem, "remove one of them, or correct it, in mm"
