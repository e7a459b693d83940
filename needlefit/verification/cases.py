"""Draw random insertions, far wider than any prior of a fit; the tissue's reaction computed a second time.

The reaction is that of docs/model.md 3, independent of the code under test: k is the derivative of the true
stress that a law's strain energy gives, by differences, and not the k that its file states to the kernel.
Complex numbers are accepted: derivatives are complex steps. Shapes are compared between their nodes too: a
small error at the nodes proves little.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Self, TypeVar

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from needlefit.arrays import Floats, Ints
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step, TrackedTip
from needlefit.mechanics.laws import LAWS, Numbers
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import Lattice
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.verification.check import worst

STEP = 1e-30

#: central differences of eighth order: multiples of the step, their weights, and the step over lambda. For
#: powers of lambda up to 12 their relative error is below 1e-12.
STENCIL, STENCIL_STEP = ((1, 4 / 5), (2, -1 / 5), (3, 4 / 105), (4, -1 / 280)), 0.003


def differentiate_stress(law: str, stretch: Numbers, shape: Sequence[Numbers]) -> Numbers:
    """Return k over mu, the derivative of the true stress; or the k of a law without one."""
    stress = LAWS[law].stress
    if stress(stretch, *shape) is None:
        return LAWS[law].k(stretch, *shape)
    step = STENCIL_STEP * stretch.real
    ends = (
        weight * (stress(stretch + m * step, *shape) - stress(stretch - m * step, *shape))  # type: ignore[operator]
        for m, weight in STENCIL
    )
    found: Numbers = sum(ends) / step
    return found


@dataclass(frozen=True)
class ReferenceLaw:
    """The parameters of all layers, each (n,) or of `shape` (p, n), real or complex."""

    mu: Numbers
    shape: Numbers
    thickness: Numbers
    friction: Numbers
    name: str

    @classmethod
    def of(cls, tissue: Tissue) -> Self:
        return cls(tissue.mu, tissue.shape, tissue.thickness, tissue.friction, tissue.law)

    def reaction(self, layer: Ints, e: Numbers, slope: Numbers) -> Numbers:
        """Return k(lambda) e g, the force per length (N / mm) at deflections `e` (mm) in the given layers."""
        mu, shape = self.mu[layer], self.shape[:, layer]
        # not abs(e): of a complex number it is real, and the complex step would be lost
        stretch = 1 - np.where(e.real < 0, -e, e) / self.thickness[layer]
        k = mu * differentiate_stress(self.name, stretch, tuple(shape))
        # sin^2(atan u') = u'^2 / (1 + u'^2)
        force: Numbers = k * e * (1 - self.friction[layer] * slope**2 / (1 + slope**2))
        return force

    def slopes(self, layer: Ints, e: Floats, slope: Floats) -> tuple[Floats, Floats]:
        """Return the derivatives of `reaction` by deflection and by slope."""
        by_e = self.reaction(layer, e + 1j * STEP, slope).imag / STEP
        by_slope = self.reaction(layer, e, slope + 1j * STEP).imag / STEP
        return by_e, by_slope

    def deflection_of(self, layer: Ints, force: Floats, slope: Floats) -> Floats:
        """Return the deflection e (mm) at which the reaction is `force` (N / mm), by bisection."""
        low = np.zeros_like(force)
        # at the full thickness the stretch is 0, and the Ogden law infinite
        high = self.thickness[layer] * (1 - 1e-12)
        for _ in range(100):
            middle = 0.5 * (low + high)
            weak = self.reaction(layer, middle, slope) < np.abs(force)
            low, high = np.where(weak, middle, low), np.where(weak, high, middle)
        return np.copysign(0.5 * (low + high), force)


PAPER_NEEDLE = Needle.from_tube(150.0, 1.27, 80e3)  #: of the paper: 150 mm, 18 gauge, 80 GPa
EXACT_OPTIONS = ModelOptions(tolerance=1e-11)  #: the default mesh, solved down to rounding


def make_tissue(
    mu: Sequence[float],
    alpha: Sequence[float],
    boundaries: Sequence[float] = (),
    thickness: Sequence[float] = (40.0,),
    friction: Sequence[float] = (0.0,),
    law: str = "ogden",
) -> Tissue:
    """Return a tissue from plain sequences of numbers, one per layer."""
    cut, t, gamma = (np.array(values, dtype=np.float64) for values in (boundaries, thickness, friction))
    return Tissue(np.array(mu), np.array(alpha), cut, t, gamma, law)


@dataclass(frozen=True)
class RandomCase:
    """A random needle, tissue and sequence of steps."""

    needle: Needle
    tissue: Tissue
    steps: tuple[Step, ...]

    def shape(self, rules: ModelOptions = EXACT_OPTIONS, lattice: Lattice | None = None) -> NeedleShape:
        """Return the shape at the end of the steps; ArithmeticError if the solver fails."""
        return require_converged(simulate_steps(self.needle, self.tissue, self.steps, rules, lattice))


T = TypeVar("T")
#: draws a case: deepest tip (mm) and softest layer (MPa)
Draw = Callable[[np.random.Generator, float, float], RandomCase]


def draw_case(rng: np.random.Generator, deepest: float = 60.0, softest: float = 1e-3) -> RandomCase:
    """Draw an insertion into 1 to 4 layers of any law: mu `softest` to 100 MPa, shape parameters up to 10."""
    count = int(rng.integers(1, 5))
    depth = float(rng.uniform(0.25, 1.0) * deepest)
    law = LAWS[str(rng.choice(LAWS.names()))]
    tissue = Tissue(
        mu=10 ** rng.uniform(np.log10(softest), 2, count),
        shape=law.draw_shape(rng, (count,)),
        # the added multiples keep boundaries at least 0.05 mm apart
        boundaries=np.sort(rng.uniform(1, depth - 0.2, count - 1)) + 0.05 * np.arange(count - 1),
        thickness=rng.uniform(5, 80, count),
        law=law.name,
    )
    base = Controls(float(rng.uniform(-1, 1)), float(rng.uniform(-0.01, 0.01)))
    return RandomCase(PAPER_NEEDLE, tissue, (Step(depth, _draw_bevel(rng), base),))


def draw_schedule(rng: np.random.Generator, deepest: float = 25.0, softest: float = 1e-3) -> RandomCase:
    """Draw a case with friction and changing inputs of all kinds, with retraction and re-insertion."""
    case = draw_case(rng, deepest, softest)
    depth = case.steps[0].depth
    stops = (0.4 * depth, 0.7 * depth, 0.55 * depth, 0.55 * depth, depth)
    tissue = replace(case.tissue, friction=rng.uniform(0, 1, case.tissue.layers))
    return RandomCase(
        PAPER_NEEDLE, tissue, tuple(Step(stop, _draw_bevel(rng), _draw_inputs(rng, depth)) for stop in stops)
    )


def _draw_bevel(rng: np.random.Generator) -> Bevel:
    return Bevel(float(rng.uniform(0.01, 0.3)), int(rng.choice([-1, 1])))


def _draw_inputs(rng: np.random.Generator, depth: float) -> Controls:
    """Return a base, and with even chances a guide before the tissue, one within it or else a tracked tip."""
    y, slope = rng.uniform(-0.5, 0.5, 8), rng.uniform(-0.01, 0.01, 4)
    guides, tip = list[Guide](), None
    if rng.random() < 0.5:
        guides.append(Guide(float(rng.uniform(-40, -5)), y[1], rng.choice([None, slope[1]])))
    # not both of the following: the tip passes the guide, and held 0.1 mm apart they bend without bound
    if rng.random() < 0.5:
        guides.append(Guide(float(rng.uniform(0.2, 0.8) * depth), y[2], None, in_tissue=True))
    elif rng.random() < 0.5:
        tip = TrackedTip(y[3], rng.choice([None, slope[3]]))
    return Controls(y[0], slope[0], slope[2], tuple(guides), tip)


def solve_cases(
    draw: Callable[[], RandomCase], solve: Callable[[RandomCase], T], count: int
) -> tuple[list[T], str]:
    """Return the results of `solve` for `count` random cases, and a remark on cases that were drawn again.

    The reference begins every stop at the straight needle, and compresses thin tissue to nothing where the
    cut has left the axis by more than its thickness. Such a case is drawn again, and counted.
    """
    found, unsolved = list[T](), 0
    while len(found) < count:
        try:
            with np.errstate(invalid="ignore"):
                found.append(solve(draw()))
        except ArithmeticError:
            unsolved += 1
            # a solver that always fails must not be redrawn for ever
            if unsolved > 2 * count:
                raise
    return found, f"{unsolved} more drawn in which the reference finds no solution" if unsolved else ""


def require_converged(shape: NeedleShape) -> NeedleShape:
    """Return the shape; ArithmeticError if the solver did not converge."""
    if not shape.converged:
        raise ArithmeticError(f"the solver failed: {shape.status}")
    return shape


def sample_between(edges: Floats) -> Floats:
    """Return eight positions inside each interval between increasing edges."""
    inside = (np.arange(8) + 0.5) / 8
    return (edges[:-1, None] + np.diff(edges)[:, None] * inside).ravel()


def sample_densely(shape: NeedleShape, start: float | None = None) -> Floats:
    """Return the nodes of a shape and positions between them, from `start` (default the base) on."""
    x = np.union1d(shape.x, sample_between(shape.x))
    return x if start is None else x[x >= start]


def interpolate(shape: NeedleShape, x: Floats) -> Floats:
    """Return the deflection, mm, at depths x, by the cubics that the nodes define."""
    return CubicHermiteSpline(shape.x, shape.u, shape.slope)(x)


def largest_difference(shape: NeedleShape, other: NeedleShape) -> float:
    """Return the largest difference of deflection between two shapes, mm, at and between their nodes."""
    start = worst([shape.x[0], other.x[0]])
    x = np.union1d(sample_densely(shape, start), sample_densely(other, start))
    x = x[x <= np.min([shape.x[-1], other.x[-1]])]
    return worst(np.abs(interpolate(shape, x) - interpolate(other, x)))
