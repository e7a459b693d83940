"""Check the advance by the path angle, and report how the tip depends on the constraint spacing C_int.

By the path angle the tip has a limit as C_int shrinks. By the paper's rule C_int is part of the model and no
mesh size: b turns the cut once per C_int, so halving C_int at fixed b turns the needle more often; b halved
with it turns as much per mm, and still does not give the same needle.
"""

import numpy as np

from needlefit.mechanics.control import Bevel, ModelOptions
from needlefit.mechanics.simulate import simulate
from needlefit.verification.cases import PAPER_NEEDLE, make_tissue, require_converged
from needlefit.verification.check import (
    AcceptanceBound,
    Check,
    CheckOutcome,
    ConvergenceCurve,
    Group,
    Quantity,
    at_most,
    define_check,
    within,
    worst,
)

DEPTH, ANGLE = 50.0, 0.1  # mm, rad
SPACINGS = (2.0, 1.0, 0.5, 0.25)
FINEST = 0.0625
#: k = 3 mu, MPa: how far the tip may be from its limit at C_int = 1 mm, as a fraction
MODULI = {0.66: 0.001, 96.0: 0.005}
#: mm: where tissue of k = 0.66 MPa gives way to tenfold k, and how far the tip may be from its limit then
BOUNDARY, LAYERED_ERROR = 25.0, 0.005
NEARLY = 1e-6  # mm
PLACES = (12.0, 12.5, 30.0)  # mm: at and between constraint points


def find_tip(k: float, spacing: float, depth: float = DEPTH, boundary: float | None = None) -> float:
    """Return the tip's deflection u, mm; behind a boundary the tissue is ten times as stiff."""
    mu = [k / 3] if boundary is None else [k / 3, 10 * k / 3]
    tissue = make_tissue(mu, [1.0] * len(mu), [] if boundary is None else [boundary])
    rules = ModelOptions(spacing, spacing, tolerance=1e-11, advance="path_angle")
    shape = simulate(PAPER_NEEDLE, tissue, Bevel(cut_angle=ANGLE), depth, rules=rules)
    return float(require_converged(shape).u[-1])


def _order(k: float, allowed: float, boundary: float | None = None) -> Check:
    layered = "" if boundary is None else f" and, from {boundary:g} mm on, tenfold k"

    def measure(rng: np.random.Generator) -> CheckOutcome:
        # the error of the finest one is removed as an order of two has it
        fine, finer = (find_tip(k, one, boundary=boundary) for one in (2 * FINEST, FINEST))
        limit = finer + (finer - fine) / 3
        errors = tuple(abs(find_tip(k, spacing, boundary=boundary) / limit - 1) for spacing in SPACINGS)
        curve = ConvergenceCurve(f"path angle, k = {k:g} MPa{layered}", SPACINGS, {"tip": errors})
        return CheckOutcome((curve.order("tip"), errors[SPACINGS.index(1.0)]), curves=(curve,))

    return Check(
        Group.PATH_ANGLE,
        f"The tip in tissue of k = {k:g} MPa{layered}, {DEPTH:g} mm deep, C_int = 2 to 0.25 mm",
        (
            Quantity("order of its error", within(2.0, 0.25), ""),
            Quantity("error at C_int = 1 mm over the deflection", at_most(allowed), ""),
        ),
        measure,
    )


@define_check(
    Group.PATH_ANGLE,
    "Long uniform tissue of k = 96 MPa",
    Quantity("curvature over θ β, less 1", at_most(0.01), ""),
)
def curvature(rng: np.random.Generator) -> CheckOutcome:
    k = 96.0
    beta = (k / 4 / PAPER_NEEDLE.flexural_rigidity) ** 0.25
    rules = ModelOptions(advance="path_angle")
    shape = simulate(PAPER_NEEDLE, make_tissue([k / 3], [1.0]), Bevel(cut_angle=ANGLE), 120.0, rules=rules)
    middle = slice(-60, -50)
    turns = np.diff(require_converged(shape).slope)[middle] / np.diff(shape.x)[middle]
    return CheckOutcome((worst(np.abs(turns / (ANGLE * beta) - 1)),))


@define_check(
    Group.PATH_ANGLE,
    "Depth, and a boundary before tenfold k, moved by 1e-6 mm at and between constraint points",
    Quantity("change of the tip by the depth", at_most(1e-5), "mm"),
    Quantity("change of the tip by the boundary", at_most(1e-5), "mm"),
)
def continuity(rng: np.random.Generator) -> CheckOutcome:
    deeper = [find_tip(0.66, 1.0, at + NEARLY) - find_tip(0.66, 1.0, at) for at in (*PLACES, DEPTH)]
    shifted = [find_tip(0.66, 1.0, boundary=at + NEARLY) - find_tip(0.66, 1.0, boundary=at) for at in PLACES]
    return CheckOutcome((worst(np.abs(deeper)), worst(np.abs(shifted))))


OFFSET = 0.085


@define_check(
    Group.STATED,
    "The tip in four layers of the paper’s values, 50 mm deep",
    Quantity(f"deflection, C_int = 1 mm, b = {OFFSET:g} mm", AcceptanceBound(), "mm"),
    Quantity(f"deflection, C_int = 0.5 mm, b = {OFFSET:g} mm", AcceptanceBound(), "mm"),
    Quantity(f"deflection, C_int = 0.5 mm, b = {OFFSET / 2:g} mm", AcceptanceBound(), "mm"),
)
def tips(rng: np.random.Generator) -> CheckOutcome:
    tissue = make_tissue([0.2, 33.0, 0.2, 33.0], [1.0, -1.0, 1.0, -1.0], [20.0, 28.0, 45.0])

    def tip(spacing: float, offset: float) -> float:
        rules = ModelOptions(spacing, spacing)
        return require_converged(
            simulate(PAPER_NEEDLE, tissue, Bevel(offset), DEPTH, rules=rules)
        ).tip_lateral

    return CheckOutcome((tip(1.0, OFFSET), tip(0.5, OFFSET), tip(0.5, OFFSET / 2)))


CHECKS = (
    *(_order(*one) for one in MODULI.items()),
    _order(0.66, LAYERED_ERROR, BOUNDARY),
    *(curvature, continuity, tips),
)
