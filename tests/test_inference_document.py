"""The posterior density, programmed again from docs/inference.md alone: NumPy, and simulated needles."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from problem_cases import make_problem
from scipy.interpolate import BSpline

from needlefit import Bevel, Controls, Guide, ModelOptions, Step, Tissue, compute_positions, simulate_steps
from needlefit.datasets.read import read
from needlefit.mechanics.packing import MAX_TOLERANCE_MM
from needlefit.project.locate import find_file
from needlefit.project.toml import load
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import LikelihoodRecord

MEDIUM = load(find_file("medium", "phantom2"), MediumRecord)
VALUES = {"mu1_pa": 2.18e5, "mu2_pa": 4.07e7, "mu3_pa": 2.55e5, "mu4_pa": 3.4e7, "bevel_mm": 0.103}
ALPHAS = (1.0, -1.0, 1.0, -1.0)
TAU, PRIOR_TAU = 0.07, 0.1
CHOSEN = ("phantom2-01", "phantom2-04", "phantom2-07")


@pytest.fixture(scope="module")
def twin():
    return read(Path(__file__).parents[1] / "data" / "twin" / "dataset.toml")


def bend(dataset, one, s, boundaries, depth, bevel):
    """Return the points (K, 2) of the simulated needle at `s` (K,)."""
    mu = np.array([VALUES[f"mu{layer}_pa"] * 1e-6 for layer in one.sequence])  # MPa
    alpha = np.array([ALPHAS[layer - 1] for layer in one.sequence])
    tissue = Tissue(mu, alpha, boundaries, thickness=np.array([MEDIUM.thickness_mm]), law=MEDIUM.law)
    guides = () if one.guide_distance is None else (Guide(-one.guide_distance),)
    options = ModelOptions(tolerance=MAX_TOLERANCE_MM, first_cell=MEDIUM.first_cell_mm)
    step = Step(depth, Bevel(bevel, one.side), Controls(guides=guides))
    return compute_positions(simulate_steps(one.needle, tissue, (step,), options), s)[:, :2]


def put_in_order(boundaries):
    """Section 4: boundaries 1e-3 mm apart."""
    found, last = [], 0.0
    for depth in boundaries:
        last = max(depth, last + 1e-3)
        found.append(last)
    return np.array(found)


def list_depth_errors(one):
    """Section 4: per error its move of boundaries and depth by one SD, own and shared part, and surface."""
    count = len(one.boundaries)
    found = [(np.full(count, one.depth_sd), one.depth_sd, 1.0, 0.0, None)]
    stated = 0.1 if one.boundary_shared_sd is None else one.boundary_shared_sd
    shared = min(stated, one.boundary_sd)
    own = max(one.boundary_sd**2 - shared**2, 0.02**2) ** 0.5
    whole, known = np.hypot(own, shared), set()
    for k, pair in enumerate(zip(one.sequence, one.sequence[1:], strict=False)):
        surface = (one.specimen, *sorted(pair))
        first = surface not in known
        known.add(surface)
        parts = (own / whole, shared / whole, surface) if first else (1.0, 0.0, None)
        found.append((whole * np.eye(count)[k], 0.0, *parts))
    return found


def prepare_sections(dataset, one, scale):
    """Section 2: where the needle is read, G, the measured y, and the covariance of the coefficients."""
    kept = one.sections
    s = np.minimum(one.depth, kept.s * one.depth / kept.s[-1])
    inside = s >= one.depth - one.needle.length + 4 * one.depth_sd
    s, q, w = s[inside], kept.q[inside], kept.weights[inside]
    x, y, _ = one.frame.rotation.T @ (kept.points[inside] - one.frame.origin).T
    size = len(kept.knots) - 4
    basis = BSpline(kept.knots, np.eye(size), 3)
    b = basis(q)
    used = np.any(b[w > 0] > 0, axis=0)
    b, slope = b[:, used], basis.derivative()(q)[:, used]
    inverse = np.linalg.inv(b.T @ np.diag(w) @ b)
    g = inverse @ b.T @ np.diag(w)
    kernel = np.exp(-np.abs(s[:, None] - s) / 7.5)
    noise = kept.sigma**2 * inverse + kept.shared_sd**2 * g @ kernel @ g.T
    modes = np.column_stack([np.ones(len(x)), x, -(slope @ g @ y) / (slope @ g @ x)])
    return s, g, np.column_stack([x, y]), scale**2 * noise, g @ modes


def prepare_points(dataset, one, scale):
    """Sections 1 and 3: the same of at most 200 stored points."""
    along = one.measure_arc("plane")  # of the smoothed points, which test_measured_curve checks
    thinned = slice(None, None, -int(np.ceil(len(along) / 200)))
    if dataset.pose == "known":
        s, points = along * one.depth / along[-1], one.points[:, :2]
    else:
        s, points = one.depth - (along[-1] - along), one.points[:, :2]
    s, points = s[thinned][::-1], points[thinned][::-1]
    noise, apart = dataset.noise, np.abs(s[:, None] - s)
    sd = np.full(len(along), noise.correlated_sd) if one.sd is None else one.sd
    sd = sd[thinned][::-1]
    shared = np.outer(sd, sd) * np.exp(-apart / noise.correlation_length)
    cov = scale**2 * (shared + noise.point_sd**2 * np.eye(len(s)))
    if dataset.pose == "free":
        points = turn_to_entry_side(points)
    x, y = points.T
    slope = np.polynomial.Polynomial.fit(x, y, 3).deriv()(x)
    return s, np.eye(len(s)), points, cov, np.column_stack([np.ones(len(x)), x, -slope])


def turn_to_entry_side(points):
    """Section 1: x along the least-squares line through the first fifth of the points."""
    side = points[: max(2, round(0.2 * len(points)))]
    _, _, (x, *_) = np.linalg.svd(side - side.mean(axis=0))
    x = x * np.sign(x @ (side[-1] - side[0]))
    return (points - points[0]) @ np.array([x, [-x[1], x[0]]]).T


def lay_on(points, measured):
    """Section 1: least-squares rigid alignment in the plane."""
    a, b = points - points.mean(axis=0), measured - measured.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1.0, np.linalg.det(u @ vt)]) @ vt
    return a @ turn + measured.mean(axis=0)


def find_log_density(dataset, insertions, prepare, scale=1.0):
    """Sections 1 to 7: log likelihood and prior of the values above."""
    residuals, blocks, surfaces, bevels, norm = [], [], [], [], 0.0
    for one in insertions:
        s, g, points, cov, modes = prepare(dataset, one, scale)

        def compare(boundaries, depth, bevel, one=one, s=s, points=points):
            found = bend(dataset, one, s + depth - one.depth, put_in_order(boundaries), depth, bevel)
            found = lay_on(found, points) if dataset.pose == "free" else found
            return found[:, 1] - points[:, 1]

        b = VALUES["bevel_mm"]
        rows = [compare(one.boundaries, one.depth, b)]
        errors = list_depth_errors(one)
        for move, deep, *_ in errors:
            ends = [compare(one.boundaries + t * move, one.depth + t * deep, b) for t in (-1, 1)]
            rows.append((ends[1] - ends[0]) / 2)
        ends = [compare(one.boundaries, one.depth, b * factor) for factor in (0.9, 1.1)]
        rows.append((ends[1] - ends[0]) / 0.2)
        rows = np.array(rows) @ g.T
        if dataset.pose == "known":
            shift = max(one.pose_shift_sd, dataset.noise.registration_mean / (8 / np.pi) ** 0.5)
            spread = modes * [shift, one.pose_angle_sd, shift]
            cov = cov + spread @ spread.T
        else:  # the projection of section 3, in a basis of what the two columns cannot reach
            free = modes[:, :2]
            white = np.linalg.inv(np.linalg.cholesky(cov))
            rest = np.linalg.svd(white @ free)[0][:, 2:]
            norm -= 0.5 * (
                np.linalg.slogdet(cov)[1] + np.linalg.slogdet(free.T @ np.linalg.solve(cov, free))[1]
            )
            rows, cov = rows @ white.T @ rest, np.eye(len(s) - 2)
        for slope, (_, _, own, _, _) in zip(rows[1:], errors, strict=False):
            cov = cov + own**2 * np.outer(slope, slope)
        residuals.append(rows[0])
        blocks.append(cov)
        surfaces.append({e[4]: e[3] * row for e, row in zip(errors, rows[1:], strict=False) if e[4]})
        bevels.append(TAU * rows[-1])
    sizes = np.cumsum([0, *map(len, residuals)])
    whole = np.zeros((sizes[-1], sizes[-1]))
    for i, j in np.ndindex(len(blocks), len(blocks)):
        part = whole[sizes[i] : sizes[i + 1], sizes[j] : sizes[j + 1]]
        part += blocks[i] if i == j else 0.0
        part += ((i == j) - 1 / len(blocks)) * np.outer(bevels[i], bevels[j])
        for surface in surfaces[i].keys() & surfaces[j].keys():
            part += np.outer(surfaces[i][surface], surfaces[j][surface])
    r = np.concatenate(residuals)
    log_l = -0.5 * (r @ np.linalg.solve(whole, r) + np.linalg.slogdet(whole)[1] + len(r) * np.log(2 * np.pi))
    ratios = np.log([VALUES["mu3_pa"] / VALUES["mu1_pa"], VALUES["mu4_pa"] / VALUES["mu2_pa"]])
    log_ties = -0.5 * np.sum((ratios / np.log(1.2)) ** 2)
    log_tau = np.log(TAU / PRIOR_TAU) - TAU**2 / (2 * PRIOR_TAU**2) + 0.5  # 0 at its peak
    return log_l + norm + log_ties + log_tau


@pytest.mark.parametrize("pose", ["known", "free"])
@pytest.mark.parametrize("measurement", ["stored", "points"])
@pytest.mark.parametrize("scale", [1.0, 1.7])
def test_the_document_gives_the_posterior_density(twin, pose, measurement, scale):
    dataset = replace(twin, pose=pose)
    insertions = [one for one in twin.insertions if one.id in CHOSEN]
    record = LikelihoodRecord(measurement=measurement, noise_scale=scale)
    problem = make_problem(dataset, insertions, MEDIUM, record).searched
    values = VALUES | {"bevel_spread": TAU}
    theta = np.log([values[name] for name in problem.parameters.free])
    sections = pose == "known" and measurement == "stored"
    expected = find_log_density(dataset, insertions, prepare_sections if sections else prepare_points, scale)
    assert problem.log_posterior(theta) == pytest.approx(expected, abs=1e-6)
