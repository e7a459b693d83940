"""Compute the density of whitened residuals, marginalised over uncertain depths, bevel and pose.

Their effects are taken as linear.

`white` (m, R) are the residuals at the m nodes of one insertion, and behind them the constant curves of its
pose. All that the density needs of them is their products G = white white^T. `scale` multiplies the
deviations of the points' noise, not those of pose and depths; `spread` is the bevel CV between insertions.
The insertions of a `NodeGroup` share errors of depth, or a bevel. A solve that failed is NaN, and so is what
comes of it.
"""

import math
from collections.abc import Sequence

import numpy as np

from needlefit.arrays import Floats
from needlefit.inference.likelihood.nodes import BEVEL, NodeGroup, Nodes


def log_marginals(whites: Sequence[Floats], group: NodeGroup, scale: Floats, spread: Floats) -> Floats:
    """Return the log densities (B,), not normalised, of the residuals (B, m, R) of a group's insertions.

    `scale` and `spread` are (B,).
    """
    density, products = np.zeros(len(scale)), []
    for white, nodes in zip(whites, group.nodes, strict=True):
        whole = white @ white.transpose(0, 2, 1) / scale[:, None, None] ** 2  # (B, m, m)
        reduced, log_det = _integrate_effects(whole, nodes, spread)
        density = density - white.shape[2] * np.log(scale) - 0.5 * log_det
        products.append(reduced)
    gained, log_det, moved, weight = (np.zeros(len(scale)) for _ in range(4))
    for places, part in group.parts:
        total, own_det = _sum_over_group([products[place] for place in places], part, spread)
        # completing the square in what is shared: its precision is stiff, its mean solve(stiff, -pull)
        stiff, pull = np.eye(len(part.surfaces)) + total[:, 1:, 1:], total[:, 1:, 0]
        bevels = np.broadcast_to(part.bevels, pull.shape)
        by_pull, by_bevels = np.moveaxis(np.linalg.solve(stiff, np.stack([pull, bevels], axis=2)), 2, 0)
        gained += np.sum(pull * by_pull, axis=1) - total[:, 0, 0]
        moved, weight = moved + np.sum(pull * by_bevels, axis=1), weight + np.sum(bevels * by_bevels, axis=1)
        log_det += own_det + _log_det(stiff)
    if group.centred:  # bevels sum to zero
        gained -= moved**2 / weight
        log_det += np.log(weight / group.bevels.sum())
    return density + 0.5 * (gained - log_det)


def _begin_precision(group: NodeGroup, sets: int) -> tuple[Floats, float]:
    """Return the prior precision (B, k, k) of what is shared, and a constant of its log determinant.

    Where bevels sum to zero, a last row and column state that: Lagrange's multiplier of a condition, which is
    not of unit length.
    """
    stiff = np.eye(len(group.surfaces) + group.centred)
    if group.centred:
        stiff[-1, :-1] = stiff[:-1, -1] = group.bevels
        stiff[-1, -1] = 0.0
    constant = -math.log(group.bevels.sum()) if group.centred else 0.0
    return np.tile(stiff, (sets, 1, 1)), constant


def solve_shared(
    whites: Sequence[Floats], group: NodeGroup, scale: Floats, spread: Floats
) -> tuple[Floats, Floats]:
    """Return mean (B, k) and covariance (B, k, k) of what insertions share, given their residuals (B, m, R).

    In standard deviations; `scale` and `spread` are (B,).
    """
    products = [
        _integrate_effects(white @ white.transpose(0, 2, 1) / scale[:, None, None] ** 2, nodes, spread)[0]
        for white, nodes in zip(whites, group.nodes, strict=True)
    ]
    total, _ = _sum_over_group(products, group, spread)
    stiff = np.eye(len(group.surfaces)) + total[:, 1:, 1:]
    covariance = np.asarray(np.linalg.inv(stiff), dtype=np.float64)
    return -(covariance @ total[:, 1:, :1])[..., 0], covariance


def weigh_linear(nodes: Nodes, spread: Floats) -> Floats:
    """Return `nodes.linear` (B, 1 + d, m), the slope by a bevel's t for each `spread` (B,)."""
    of_bevel = np.array([False, *(axis.of_bevel for axis in nodes.axes)])
    weights = np.where(of_bevel, spread[:, None], 1.0)
    return weights[:, :, None] * nodes.linear


def _sum_over_group(products: Sequence[Floats], group: NodeGroup, spread: Floats) -> tuple[Floats, Floats]:
    """Return the products (B, 1 + k, 1 + k) of the residuals and of their slopes by what is shared.

    The insertions' own errors are integrated out; the log determinants (B,) of that come second.
    """
    size, count = 1 + len(group.surfaces), len(products[0])
    total, log_det = np.zeros((count, size, size)), np.zeros(count)
    for part, (member, places) in zip(products, group.members, strict=True):
        (nodes,), (own_columns,), (shared,) = member.nodes, member.own, member.shared
        linear = weigh_linear(nodes, spread)
        gram = linear @ part @ linear.transpose(0, 2, 1)  # (B, 1 + d, 1 + d)
        loaded = own_columns[:, None] * gram[:, 1:]
        stiff = np.eye(len(own_columns)) + loaded[:, :, 1:] * own_columns
        gram = gram - loaded.transpose(0, 2, 1) @ np.linalg.solve(stiff, loaded)
        # of (1, t) to those of (1, z) that it shares
        into, place = np.append(0, 1 + places), np.eye(1 + len(places), 1 + len(own_columns))
        place[1:, 1:] = shared.T
        total[:, into[:, None], into] += place @ gram @ place.T
        log_det = log_det + _log_det(stiff)
    return total, log_det


def _integrate_effects(products: Floats, nodes: Nodes, spread: Floats) -> tuple[Floats, Floats]:
    """Return the products (B, m, m) with pose and bevel integrated out, and the log determinants (B,)."""
    if not len(nodes.effects):
        return products, np.zeros(len(products))
    loads = load_effects(nodes, spread)  # (B, l)
    pull = loads[:, :, None] * (nodes.effects @ products)  # (B, l, m)
    stiff = np.eye(len(nodes.effects)) + pull @ nodes.effects.T * loads[:, None]
    return products - pull.transpose(0, 2, 1) @ np.linalg.solve(stiff, pull), _log_det(stiff)


def load_effects(nodes: Nodes, spread: Floats) -> Floats:
    """Return the deviations (B, l) of the coefficients: of the bevel `spread`, of the pose 1."""
    loads = np.ones((len(spread), len(nodes.effects)))
    if nodes.bevel:
        loads[:, 0] = spread
    return loads


def linearize_residuals(
    whites: Sequence[Floats],
    by: Sequence[Floats],
    group: NodeGroup,
    residuals_at: tuple[Floats, Floats],
    by_log_spread: Floats,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return residuals (B, R + D) and log det (B,) of the density, -(|residuals|^2 + log det) / 2, and their
    derivatives (B, R + D, P) and (B, P), given those of white, (B, m, R, P).

    The residuals are those at the conditions that fit best, and these D conditions' own, in standard
    deviations, insertion by insertion; `count_residuals` says how many belong to each. `at` are scale and
    spread; `by_log_spread` (P,) are the derivatives of the latter's logarithm.
    """
    sets, free = len(residuals_at[0]), by[0].shape[-1]
    # the conditions of an insertion meet those of the others in what is shared alone: with that at last, the
    # precision of all conditions is block-diagonal with a border
    corner, constant = _begin_precision(group, sets)
    pull, log_det, given = np.zeros(corner.shape[:2]), np.full(sets, constant), []
    for white, by_white, (own_group, places) in zip(whites, by, group.members, strict=True):
        first, slopes = stack_residuals([white], own_group, *residuals_at)
        by_first, by_slopes = stack_residuals([by_white], own_group, *residuals_at)
        bevels = np.array(_list_bevel_conditions(own_group), dtype=np.float64)
        by_slopes = by_slopes + (bevels[:, None] * slopes)[..., None] * by_log_spread
        own_slopes, held = np.split(
            slopes, [slopes.shape[1] - len(places)], axis=1
        )  # conditions of its own, shared
        border = own_slopes @ held.transpose(0, 2, 1)
        stiff = np.eye(own_slopes.shape[1]) + own_slopes @ own_slopes.transpose(0, 2, 1)
        pulled = np.concatenate([own_slopes @ first[..., None], border, own_slopes], axis=2)
        solved = np.linalg.solve(stiff, pulled)
        to_pull, to_border, to_own = np.split(solved, [1, 1 + len(places)], axis=2)
        turned = border.transpose(0, 2, 1)
        corner[:, places[:, None], places] += held @ held.transpose(0, 2, 1) - turned @ to_border
        pull[:, places] += (held @ first[..., None] - turned @ to_pull)[..., 0]
        log_det = log_det + _log_det(stiff)
        given.append((places, first, slopes, border, stiff, to_pull, to_border, to_own, by_first, by_slopes))
    inverse, log_det = np.linalg.inv(corner), log_det + _log_det(corner)
    best = -(inverse @ pull[..., None])[..., 0]
    by_pull, by_det, parts = np.zeros((*pull.shape, free)), np.zeros((sets, free)), []
    for places, first, slopes, border, stiff, to_pull, to_border, to_own, by_first, by_slopes in given:
        count, rows, conditions = len(stiff[0]), first.shape[1], slopes.shape[1]
        own_best = -(to_pull + to_border @ best[:, places, None])[..., 0]
        fits = np.concatenate([own_best, best[:, places]], axis=1)
        left = first + (fits[:, None] @ slopes)[:, 0]  # (B, R)
        flat = by_slopes.reshape(sets, conditions, rows * free)
        by_left = by_first + (fits[:, None] @ flat).reshape(sets, rows, free)  # conditions held
        # derivative of the normal equations stiff @ best = -slopes @ first; terms in by_slopes @ left are not
        # zero off the optimum
        by_normal = (left[:, None, None] @ by_slopes)[:, :, 0] + slopes @ by_left  # (B, D, P)
        by_best = np.linalg.solve(stiff, by_normal[:, :count])
        turned = border.transpose(0, 2, 1)
        by_pull[:, places] += by_normal[:, count:] - turned @ by_best
        weights = inverse[:, places[:, None], places] @ (slopes[:, count:] - turned @ to_own)
        weights = np.concatenate([to_own - to_border @ weights, weights], axis=1)
        flat = weights.reshape(sets, 1, conditions * rows)
        by_det = by_det + 2 * (flat @ by_slopes.reshape(sets, conditions * rows, free))[:, 0]
        parts.append((places, left, own_best, by_left, by_best, slopes, to_border))
    by_shared, shared = -(inverse @ by_pull), slice(len(group.surfaces))
    pairs = []
    for places, left, own_best, by_left, by_best, slopes, to_border in parts:
        by_own = -by_best - to_border @ by_shared[:, places]
        by_all = np.concatenate([by_own, by_shared[:, places]], axis=1)
        pairs += [(left, by_left + slopes.transpose(0, 2, 1) @ by_all), (own_best, by_own)]
        if len(pairs) == 2:  # what is shared stands behind the first insertion
            pairs.append((best[:, shared], by_shared[:, shared]))
    residuals, by_residuals = (np.concatenate(side, axis=1) for side in zip(*pairs, strict=True))
    return residuals, log_det, by_residuals, by_det


def _list_bevel_conditions(group: NodeGroup) -> list[bool]:
    """Return which of the conditions are a bevel's."""
    conditions: list[bool] = []
    for nodes in group.nodes:
        conditions += [axis.of_bevel for axis in nodes.axes]
        conditions += [nodes.bevel and k == 0 for k in range(len(nodes.effects))]
    return [*conditions, *(surface[1] == BEVEL for surface in group.surfaces)]


def count_residuals(group: NodeGroup, rows: Sequence[int]) -> list[int]:
    """Return how many of `linearize_residuals` belong to each insertion of `rows` points' residuals.

    What insertions share stands behind the first of them.
    """
    counts = [row + size for row, size in zip(rows, _count_own(group), strict=True)]
    counts[0] += len(group.surfaces)
    return counts


def stack_residuals(
    whites: Sequence[Floats], group: NodeGroup, scale: Floats, spread: Floats
) -> tuple[Floats, Floats]:
    """Return all residuals (B, R) as measured, and their slopes (B, D, R) by a deviation of each condition.

    The conditions are each insertion's own depths and bevel, then the surfaces. Of derivatives (B, m, R, P)
    in place of `whites` (B, m, R) it returns those of both, (B, R, P) and (B, D, R, P).
    """
    ends = np.cumsum([0, *(white.shape[2] for white in whites)])
    sizes = np.cumsum([0, *_count_own(group)])
    sets, more = len(scale), whites[0].shape[3:]
    first = np.empty((sets, ends[-1], *more))
    slopes = np.zeros((sets, sizes[-1] + len(group.surfaces), ends[-1], *more))
    members = zip(whites, group.nodes, group.own, group.shared, strict=True)
    for k, (white, nodes, own_columns, shared) in enumerate(members):
        rest = white.shape[2:]  # (R,) or (R, P)
        flat = white.reshape(sets, white.shape[1], math.prod(rest)) / scale[:, None, None]  # (B, m, R P)
        turned = weigh_linear(nodes, spread) @ flat  # (B, 1 + d, R P)
        rows, here = slice(ends[k], ends[k + 1]), sizes[k]
        first[:, rows] = turned[:, 0].reshape(sets, *rest)
        slopes[:, here : here + len(own_columns), rows] = (own_columns[:, None] * turned[:, 1:]).reshape(
            sets, len(own_columns), *rest
        )
        loads = load_effects(nodes, spread)  # (B, l)
        effects = loads[:, :, None] * (nodes.effects @ flat)
        here += len(own_columns)
        slopes[:, here : here + loads.shape[1], rows] = effects.reshape(sets, loads.shape[1], *rest)
        slopes[:, sizes[-1] :, rows] = (shared.T @ turned[:, 1:]).reshape(sets, shared.shape[1], *rest)
    return first, slopes


def _count_own(group: NodeGroup) -> list[int]:
    return [len(nodes.axes) + len(nodes.effects) for nodes in group.nodes]


def _log_det(stiff: Floats) -> Floats:
    with np.errstate(invalid="ignore"):  # of a NaN
        log_det: Floats = np.linalg.slogdet(stiff)[1]
    return log_det
