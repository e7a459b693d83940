"""Check the Jacobian of the whole shape against complex-step derivatives of the readable reference.

A parameter p enters the residual R of a stop directly and through the constraint points, whose derivatives
are known from the stops before: du/dp = -K_T^-1 dR/dp, the state fixed in dR/dp. Im R(p + i h) / h is that
derivative to rounding, since nothing is subtracted. What moves quadrature points or nodes (boundaries,
guides along the needle) is stepped in real numbers, on both sides and twice: R of a fixed state has no noise
of a solution.
"""

from dataclasses import dataclass, replace

import numpy as np

from needlefit.arrays import Bools, Floats
from needlefit.mechanics import reference
from needlefit.mechanics.batch import linearize_steps
from needlefit.mechanics.control import Controls, ModelOptions
from needlefit.mechanics.laws import LAWS, Numbers
from needlefit.mechanics.plan import TipStop, make_lattice, plan_stops
from needlefit.verification.cases import (
    EXACT_OPTIONS,
    STEP,
    Draw,
    RandomCase,
    ReferenceLaw,
    draw_case,
    draw_schedule,
    require_converged,
    solve_cases,
)
from needlefit.verification.check import Check, CheckOutcome, Group, Quantity, at_most, worst

_LAYERED = ("mu", "friction")
_SINGLE = ("rigidity", "offset", "base_y", "base_slope", "stage_slope")
PARAMETER_KINDS = (*_LAYERED, "shape", *_SINGLE, "boundaries", "guides")
_MAX_STEP_MM = 1e-4  # the longer of the two real steps, unless a node or change of constraint lies so near


@dataclass(frozen=True)
class Parameter:
    """One parameter to differentiate by: its kind, and which layer, boundary or guide (from 0).

    Of a shape parameter `row` is its place among those of the law.
    """

    kind: str
    number: int = 0
    row: int = 0


@dataclass(frozen=True)
class Equilibrium:
    """The equilibrium of one stop: `u` (2 N,) at its nodes, prescribed where `held`."""

    nodes: Floats
    points: Numbers  # (M + 1, 2)
    u: Numbers
    held: Bools
    change: Floats  # (M,) depths at which the tissue changes from one point to the next


def parameters(case: RandomCase) -> dict[str, Parameter]:
    """Return all parameters of a case, keyed by the names that a `Jacobian` gives them."""
    named = {f"{kind}{i + 1}": Parameter(kind, i) for kind in _LAYERED for i in range(case.tissue.layers)}
    shape = LAWS[case.tissue.law].name_shape(range(1, case.tissue.layers + 1))
    named |= {name: Parameter("shape", i, p) for p, row in enumerate(shape) for i, name in enumerate(row)}
    named |= {kind: Parameter(kind) for kind in _SINGLE}
    named |= {f"boundary{i + 1}": Parameter("boundary", i) for i in range(case.tissue.layers - 1)}
    for i in range(len(_guide_positions(case))):
        named |= {f"guide{i + 1}_{what}": Parameter(f"guide_{what}", i) for what in ("x", "y", "slope")}
    return named


def derivatives(case: RandomCase, wanted: list[Parameter], rules: ModelOptions) -> tuple[Floats, Floats]:
    """Return the derivatives of deflections and slopes (2 N, P) and of constraint points (M + 1, P)."""
    lattice = make_lattice(case.steps, rules)
    c, dc = {0: 0.0}, {0: np.zeros(len(wanted))}
    rays: dict[int, tuple[float, Floats, Floats]] = {}  # where each ray begins: x, (u, u'), and d(u, u')/dp
    x_tip, tip, dtip = 0.0, np.zeros(2), np.zeros((2, len(wanted)))
    by_offset = np.array([p.kind == "offset" for p in wanted], dtype=np.float64)
    for stop in plan_stops(case.steps, lattice, case.needle.length):
        if stop.starts_ray:
            rays[stop.ray] = x_tip, tip, dtip
        if stop.cell > 0:
            x, (u_0, slope), (du_0, dslope) = rays[stop.ray]
            bevel, ahead = case.steps[stop.bevel_id].bevel, stop.tip - x
            slope, dslope = rules.tangent * slope, rules.tangent * dslope
            # the cut goes on along the needle's tangent, turned by the bevel: b per constraint spacing
            c[stop.cell] = u_0 + ahead * (slope + bevel.side * bevel.offset / rules.spacing)
            dc[stop.cell] = du_0 + ahead * (dslope + by_offset * bevel.side / rules.spacing)
        places = [lattice.depth(m) for m in range(stop.cell)] + [stop.tip]
        points = np.column_stack((places, [c[m] for m in range(stop.cell + 1)]))
        moved = np.array([dc[m] for m in range(stop.cell + 1)])  # (M + 1, P)
        controls = case.steps[stop.controls_id].controls
        nodes, guess, held = reference.mesh(stop, controls, lattice, case.needle.length, rules.element)
        # elsewhere the first guess goes along the cut, tissue hardly compressed
        cut = np.interp(nodes, *points.T)
        guess = np.where(held, guess, np.column_stack((cut, np.gradient(cut, nodes))).ravel())
        u, _ = reference.equilibrium(case.needle, case.tissue, nodes, points, guess, held, rules)
        here = Equilibrium(nodes, points, u, held, reference.change_depths(points[:, 0], rules))
        du = state_derivatives(case, here, wanted, moved, imposed_rates(case, wanted, here, stop, controls))
        x_tip, tip, dtip = stop.tip, u[-2:], du[-2:]
    return du, moved


def imposed_rates(
    case: RandomCase, wanted: list[Parameter], here: Equilibrium, stop: TipStop, controls: Controls
) -> Floats:
    """Return the derivatives (2 N, P) of the values prescribed at the nodes."""
    base = {"base_y": (0, 1.0), "base_slope": (1, 1.0), "stage_slope": (0, stop.tip)}
    rates = np.zeros((len(here.held), len(wanted)))
    for column, p in enumerate(wanted):
        if p.kind in base:
            row, rate = base[p.kind]
            rates[row, column] = rate
        elif p.kind in ("guide_y", "guide_slope"):
            stand = _guide_position(case, p)
            node = np.flatnonzero(here.nodes == stand)
            active = len(node) > 0 and any(guide.x == stand for guide in controls.guides)
            row = 2 * int(node[0]) + (p.kind == "guide_slope") if active else 0
            rates[row, column] = float(active and here.held[row])
    return rates


def state_derivatives(
    case: RandomCase, here: Equilibrium, wanted: list[Parameter], moved: Floats, rates: Floats
) -> Floats:
    """Return du/dp (2 N, P), given the derivatives of constraint points (M + 1, P) and held values."""
    loads = np.column_stack([residual_derivative(case, here, p, moved[:, i]) for i, p in enumerate(wanted)])
    law, EI = ReferenceLaw.of(case.tissue), case.needle.flexural_rigidity
    stepped = (here.u + 1j * STEP * row for row in np.eye(len(here.u)))
    forces = [
        EI * bending_forces(here.nodes, u) + tissue_forces(case, replace(here, u=u), law) for u in stepped
    ]
    K_T = np.column_stack(forces).imag / STEP
    free = ~here.held
    du = rates.copy()
    du[free] = np.linalg.solve(K_T[np.ix_(free, free)], -(loads + K_T @ rates)[free])
    return du


def residual_derivative(case: RandomCase, here: Equilibrium, p: Parameter, moved: Floats) -> Floats:
    """Return dR/dp (2 N,) at a fixed state; the constraint points move at the rates `moved`."""
    points = here.points.astype(np.complex128)
    points[:, 1] += 1j * STEP * moved
    tissue, EI = case.tissue, complex(case.needle.flexural_rigidity)
    law = ReferenceLaw.of(tissue)
    if p.kind in (*_LAYERED, "shape"):
        values = getattr(law, p.kind).astype(np.complex128)
        values[(p.row, p.number) if p.kind == "shape" else p.number] += 1j * STEP
        law = replace(law, **{p.kind: values})
    EI += 1j * STEP if p.kind == "rigidity" else 0.0
    nodes = here.nodes + 1j * STEP * (p.kind == "guide_x") * (here.nodes == _guide_position(case, p))
    force = EI * bending_forces(nodes, here.u) + tissue_forces(case, replace(here, points=points), law)
    total: Floats = force.imag / STEP
    if p.kind in ("boundary", "guide_x"):
        # no farther than a boundary or a guide's node may be moved without passing anything
        place = tissue.boundaries[p.number] if p.kind == "boundary" else _guide_position(case, p)
        gaps = np.abs(np.concatenate((here.nodes, here.change, tissue.boundaries)) - place)
        reach = min(_MAX_STEP_MM, 0.5 * float(np.min(gaps[gaps > 0])))
        coarse, fine = (
            (_shifted_forces(case, here, p, h) - _shifted_forces(case, here, p, -h)) / (2 * h)
            for h in (reach, reach / 2)
        )
        # Richardson: cancels the error of second order of both central differences
        total = total + (4 * fine - coarse) / 3
    return total


def bending_forces(nodes: Numbers, u: Numbers) -> Numbers:
    """Return the forces and moments (2 N,) that bend the nodes' cubics, over EI."""
    h = np.diff(nodes)
    (a, slope_a), (b, slope_b) = u.reshape(-1, 2)[:-1].T, u.reshape(-1, 2)[1:].T
    shear = (12 * (a - b) + 6 * h * (slope_a + slope_b)) / h**3
    moment_a = (6 * (a - b) + h * (4 * slope_a + 2 * slope_b)) / h**2
    moment_b = (6 * (a - b) + h * (2 * slope_a + 4 * slope_b)) / h**2
    total = np.zeros((len(nodes), 2), dtype=np.result_type(nodes, u))
    total[:-1] += np.column_stack((shear, moment_a))
    total[1:] += np.column_stack((-shear, moment_b))
    return total.ravel()


def tissue_forces(case: RandomCase, here: Equilibrium, law: ReferenceLaw) -> Numbers:
    """Return the tissue's forces and moments (2 N,); state, y of the points and law may be complex."""
    boundaries = case.tissue.boundaries
    x, w = reference.quadrature(here.nodes, here.change, boundaries)
    N, dN = reference.shape_functions(here.nodes, x)
    nearest = np.searchsorted(here.change, x)
    e = N @ here.u - here.points[nearest, 1]
    return N.T @ (w * law.reaction(np.searchsorted(boundaries, x), e, dN @ here.u))


def _shifted_forces(case: RandomCase, here: Equilibrium, p: Parameter, step: float) -> Floats:
    """Return the tissue's forces with a boundary or a guide's node moved along the needle."""
    law = ReferenceLaw.of(case.tissue)
    if p.kind == "boundary":
        boundaries = case.tissue.boundaries.copy()
        boundaries[p.number] += step
        return tissue_forces(replace(case, tissue=replace(case.tissue, boundaries=boundaries)), here, law)
    nodes = np.where(here.nodes == _guide_position(case, p), here.nodes + step, here.nodes)
    return tissue_forces(case, replace(here, nodes=nodes), law)


def _guide_position(case: RandomCase, p: Parameter) -> float:
    """Return where the guide of a parameter stands, mm; NaN if it is no guide's."""
    return _guide_positions(case)[p.number] if p.kind.startswith("guide") else np.nan


def _guide_positions(case: RandomCase) -> list[float]:
    return sorted({guide.x for step in case.steps for guide in step.controls.guides})


RANDOM_CASES = 10
#: mm per unit (per logarithm of mu and EI): a column below is measured against this, for the state itself is
#: known to no better than 1e-10 mm. Of slopes: a hundredth, per mm.
MIN_COLUMN = 1e-3
PAPER_SOFTEST_MPA, SOFTEST_MPA = 0.2, 1e-3  #: the softest tissue of the paper, and far below it


@dataclass(frozen=True)
class ReferenceDerivatives:
    """Derivatives by the reference: of deflections and slopes (2 N, P), of constraint points (M + 1, P)."""

    case: RandomCase
    names: tuple[str, ...]
    du: Floats
    dc: Floats


def differentiate_reference(case: RandomCase) -> ReferenceDerivatives:
    """Return the reference's derivatives by all parameters of a case."""
    named = parameters(case)
    return ReferenceDerivatives(case, tuple(named), *derivatives(case, list(named.values()), EXACT_OPTIONS))


def measure_errors(other: ReferenceDerivatives) -> dict[str, float]:
    """Return the largest error of each column, relative to its largest entry; over lengths and slopes.

    Raises ArithmeticError if the compiled solver fails where the reference did not, ValueError if the
    Jacobian lacks a column.
    """
    case = other.case
    shape, jacobian = linearize_steps(
        case.needle, case.tissue, case.steps, EXACT_OPTIONS, wrt=PARAMETER_KINDS
    )
    require_converged(shape)
    columns = [jacobian.names.index(name) for name in other.names]
    unit = np.array([_unit(case, name) for name in other.names])
    # the reference interleaves the degrees of freedom: u at even rows, slope at odd rows
    lengths = np.vstack((jacobian.u, jacobian.constraints)), np.vstack((other.du[0::2], other.dc)), MIN_COLUMN
    slopes = jacobian.slope, other.du[1::2], 0.01 * MIN_COLUMN
    shares = [
        np.abs(ours[:, columns] - true).max(axis=0)
        * unit
        / np.maximum(np.abs(true).max(axis=0) * unit, smallest)
        for ours, true, smallest in (lengths, slopes)
    ]
    return dict(zip(other.names, map(float, np.maximum(*shares)), strict=True))


def _unit(case: RandomCase, name: str) -> float:
    """Return mu or EI for their columns, which become those of the logarithm, and 1 for the others."""
    if name == "rigidity":
        return case.needle.flexural_rigidity
    # "mu2" is layer 2, index 1
    return float(case.tissue.mu[int(name[2:]) - 1]) if name.startswith("mu") else 1.0


def _draw_layered(draw: Draw, rng: np.random.Generator, softest: float) -> RandomCase:
    """Return a case with a boundary and a shape parameter to differentiate by."""
    while True:
        case = draw(rng, 25.0, softest)
        if case.tissue.layers > 1 and len(case.tissue.shape):
            return case


def _check(title: str, draw: Draw, softest: float, bound: float) -> Check:
    def measure(rng: np.random.Generator) -> CheckOutcome:
        found, remark = solve_cases(
            lambda: _draw_layered(draw, rng, softest), differentiate_reference, RANDOM_CASES
        )
        quantity_of = {"shape": 2, "boundary": 1, "guide_x": 1}  # the others count for quantity 0
        columns = [
            (quantity_of.get(parameters(each.case)[name].kind, 0), error)
            for each in found
            for name, error in measure_errors(each).items()
        ]
        values = tuple(worst([e for kind, e in columns if kind == wanted]) for wanted in range(3))
        return CheckOutcome(values, "; ".join(filter(None, (f"{len(columns)} columns", remark, because))))

    words = ("other columns", "columns of places (boundaries, guides)", "columns of shape parameters")
    quantities = tuple(Quantity(f"error of the {each}", at_most(bound), "") for each in words)
    reach, because = "μ = 0.2", ""
    if softest != PAPER_SOFTEST_MPA:
        reach = "μ = 0.001"
        because = "the state is known to its rounding, some 10⁻¹⁰ mm, which soft tissue passes on enlarged"
    return Check(
        Group.SENSITIVITIES,
        f"{RANDOM_CASES} random {title.format(f'{reach} to 100 MPa')}",
        quantities,
        measure,
    )


_INSERTIONS = "insertions, constant inputs, {}"
_SCHEDULES = "schedules, {}: guides, tracked tip, retraction, friction"
CHECKS = (
    _check(_INSERTIONS, draw_case, PAPER_SOFTEST_MPA, 1e-7),
    _check(_SCHEDULES, draw_schedule, PAPER_SOFTEST_MPA, 1e-7),
    _check(_INSERTIONS, draw_case, SOFTEST_MPA, 1e-5),
    _check(_SCHEDULES, draw_schedule, SOFTEST_MPA, 1e-5),
)
