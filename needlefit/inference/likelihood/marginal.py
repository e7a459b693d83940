"""Compute the density of whitened residuals, marginalised over uncertain depths, bevel and pose; closed form
where curves are linear.

`white` (m, R) are the residuals at the m nodes of one insertion, and behind them the constant curves of its
pose. All that is needed of them is their
products G = white white^T, and how a density changes with them is -M white with an (m, m) matrix M: the
mean of phi phi^T over the conditions that the data leave. `scale` multiplies the deviations of the
points' noise, not those of pose and depths; `spread` is the bevel CV between insertions,
whose effect is taken as linear. The insertions of a `NodeGroup` share errors of depth, or a bevel. A solve
that failed is NaN, and so is what comes of it.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from needlefit.arrays import Bools, Floats
from needlefit.inference.likelihood.nodes import (
    BEVEL,
    NodeGroup,
    Nodes,
    QuadratureRule,
    TableAxis,
    log_means,
    make_table_axes,
    moments,
)


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
    rules = _list_rules(group)
    if rules:
        return density + log_means(_cut(products, rules), rules, _fold_axes(group, rules))
    total, log_det = _sum_over_group(products, group, spread)
    # completing the square in what is shared: its precision is stiff, its mean solve(stiff, -pull)
    stiff, pull = np.eye(len(group.surfaces)) + total[:, 1:, 1:], total[:, 1:, 0]
    gained = np.sum(pull * np.linalg.solve(stiff, pull[..., None])[..., 0], axis=1)
    return density - 0.5 * (total[:, 0, 0] - gained + log_det + _log_det(stiff))


def mixing_matrices(
    whites: Sequence[Floats], group: NodeGroup, scale: float, spread: float
) -> tuple[list[Floats], float]:
    """Return M (m, m) of each insertion's residuals (m, R), and the derivative of the density by ln `spread`.

    The derivatives of the log density by the residuals are -M white.
    """
    products = [(white @ white.T / scale**2)[None] for white in whites]
    at = np.array([spread])
    reduced = [_integrate_effects(p, nodes, at)[0] for p, nodes in zip(products, group.nodes, strict=True)]
    found, slope = _find_moments(reduced, group, at)
    mixed = []
    for part, whole, nodes in zip(found, products, group.nodes, strict=True):
        full, more = _restore_effects(part, whole[0], nodes, spread)
        mixed.append(full / scale**2)
        slope += more
    return mixed, slope


def solve_shared(
    whites: Sequence[Floats], group: NodeGroup, scale: Floats, spread: Floats
) -> tuple[Floats, Floats]:
    """Return mean (B, k) and covariance (B, k, k) of what insertions share, given their residuals (B, m, R).

    In standard deviations; without depths by quadrature. `scale` and `spread` are (B,).
    """
    products = [
        _integrate_effects(white @ white.transpose(0, 2, 1) / scale[:, None, None] ** 2, nodes, spread)[0]
        for white, nodes in zip(whites, group.nodes, strict=True)
    ]
    total, _ = _sum_over_group(products, group, spread)
    stiff = np.eye(len(group.surfaces)) + total[:, 1:, 1:]
    covariance = np.asarray(np.linalg.inv(stiff), dtype=np.float64)
    return -(covariance @ total[:, 1:, :1])[..., 0], covariance


def _find_moments(products: Sequence[Floats], group: NodeGroup, spread: Floats) -> tuple[list[Floats], float]:
    """Return of each insertion the mean (m, m) of phi phi^T over depths, without what effects add.

    The second is the derivative of the density by the logarithm of `spread` (1,), by shared bevels.
    """
    rules = _list_rules(group)
    if rules:
        found = moments(_cut(products, rules), rules, _fold_axes(group, rules))
        sizes = [nodes.linear.shape[1] for nodes in group.nodes]  # effects are not among what is integrated
        return [np.pad(one, (0, size - len(one))) for one, size in zip(found, sizes, strict=True)], 0.0
    total, _ = _sum_over_group(products, group, spread)
    covariance = np.linalg.inv(np.eye(len(group.surfaces)) + total[0, 1:, 1:])
    mean = np.concatenate(([1.0], -covariance @ total[0, 1:, 0]))
    common = np.outer(mean, mean)
    common[1:, 1:] += covariance
    found, slope = [], 0.0
    for part, nodes, own, place in _members(products, group):
        linear = weigh_linear(nodes, spread)[0]
        gram = linear @ part[0] @ linear.T
        # the insertion's own errors, given the others: mean -W gram (1, shared part), covariance W
        weight = own[:, None] * np.linalg.inv(np.eye(len(own)) + own[:, None] * gram[1:, 1:] * own) * own
        follow = np.eye(len(gram))
        follow[1:] -= weight @ gram[1:]
        restored: Floats = follow @ place.T @ common @ place @ follow.T
        restored[1:, 1:] += weight
        found.append(linear.T @ restored @ linear)
        # d/d(ln spread) is minus the mean of t (f . r)
        slope -= float(np.sum((restored * gram)[_bevel_axes(nodes)]))
    return found, slope


def weigh_linear(nodes: Nodes, spread: Floats) -> Floats:
    """Return `nodes.linear` (B, 1 + d, m), the slope by a bevel's t for each `spread` (B,)."""
    weights = np.where(_bevel_axes(nodes), spread[:, None], 1.0)
    return np.asarray(weights[:, :, None] * nodes.linear)


def _bevel_axes(nodes: Nodes) -> Bools:
    """Return which rows (1 + d,) of `nodes.linear` are the slopes by a bevel."""
    return np.array([False, *(axis.of_bevel for axis in nodes.axes)])


def _sum_over_group(products: Sequence[Floats], group: NodeGroup, spread: Floats) -> tuple[Floats, Floats]:
    """Return the products (B, 1 + k, 1 + k) of the residuals and of their slopes by what is shared.

    The insertions' own errors are integrated out; the log determinants (B,) of that come second.
    """
    size, count = 1 + len(group.surfaces), len(products[0])
    total, log_det = np.zeros((count, size, size)), np.zeros(count)
    for part, nodes, own, place in _members(products, group):
        linear = weigh_linear(nodes, spread)
        gram = linear @ part @ linear.transpose(0, 2, 1)  # (B, 1 + d, 1 + d)
        loaded = own[:, None] * gram[:, 1:]
        stiff = np.eye(len(own)) + loaded[:, :, 1:] * own
        gram = gram - loaded.transpose(0, 2, 1) @ np.linalg.solve(stiff, loaded)
        total, log_det = total + place @ gram @ place.T, log_det + _log_det(stiff)
    return total, log_det


def _members(products: Sequence[Floats], group: NodeGroup) -> Iterator[tuple[Floats, Nodes, Floats, Floats]]:
    """Yield of each insertion its products, nodes, own deviations (d,), and what takes (1, t) to (1, z)."""
    for part, nodes, own, shared in zip(products, group.nodes, group.own, group.shared, strict=True):
        place = np.zeros((1 + shared.shape[1], 1 + len(own)))
        place[0, 0], place[1:, 1:] = 1.0, shared.T
        yield part, nodes, own, place


def _integrate_effects(products: Floats, nodes: Nodes, spread: Floats) -> tuple[Floats, Floats]:
    """Return the products (B, m, m) with pose and bevel integrated out, and the log determinants (B,)."""
    if not len(nodes.effects):
        return products, np.zeros(len(products))
    loads = load_effects(nodes, spread)  # (B, l)
    pull = loads[:, :, None] * (nodes.effects @ products)  # (B, l, m)
    stiff = np.eye(len(nodes.effects)) + pull @ nodes.effects.T * loads[:, None]
    return products - pull.transpose(0, 2, 1) @ np.linalg.solve(stiff, pull), _log_det(stiff)


def _restore_effects(mixed: Floats, products: Floats, nodes: Nodes, spread: float) -> tuple[Floats, float]:
    """Return the mean of phi phi^T with the coefficients c of pose and bevel, and the slope by ln spread.

    c given the rest is Gaussian with covariance A and mean -A pull phi.
    """
    if not len(nodes.effects):
        return mixed, 0.0
    (loads,) = load_effects(nodes, np.array([spread]))
    pull = nodes.effects @ products  # (l, m)
    within = pull @ nodes.effects.T
    covariance = loads[:, None] * np.linalg.inv(np.eye(len(loads)) + loads[:, None] * within * loads) * loads
    follow = np.eye(len(products)) - nodes.effects.T @ covariance @ pull
    full = follow @ mixed @ follow.T + nodes.effects.T @ covariance @ nodes.effects
    if not nodes.bevel:
        return full, 0.0
    # d/d(ln load) of the log density is minus the mean of c (f . r)
    with_rest = -covariance @ pull @ mixed  # mean of c phi^T without what c adds to phi
    square = covariance - with_rest @ pull.T @ covariance
    return full, -float(with_rest[0] @ pull[0] + square[0] @ within[0])


def load_effects(nodes: Nodes, spread: Floats) -> Floats:
    """Return the deviations (B, l) of the coefficients: of the bevel `spread`, of the pose 1."""
    loads = np.ones((len(spread), len(nodes.effects)))
    if nodes.bevel:
        loads[:, 0] = spread
    return loads


def _list_rules(group: NodeGroup) -> list[QuadratureRule]:
    return [nodes.rule for nodes in group.nodes if nodes.rule is not None]


def _cut(products: Sequence[Floats], rules: Sequence[QuadratureRule]) -> list[Floats]:
    """Return the products at the nodes of the depths: those of the bevel come behind them."""
    sizes = [rule.steps.shape[1] for rule in rules]
    return [part[:, :size, :size] for part, size in zip(products, sizes, strict=True)]


def _fold_axes(group: NodeGroup, rules: Sequence[QuadratureRule]) -> list[tuple[TableAxis, ...]]:
    trios = zip(rules, group.own, group.shared, strict=True)
    return [make_table_axes(*trio) for trio in trios]


def linear_residuals(
    whites: Sequence[Floats], group: NodeGroup, scale: Floats, spread: Floats
) -> tuple[Floats, Floats]:
    """Return residuals (B, R + D) and log det (B,) of the linear density, -(|residuals|^2 + log det) / 2.

    These are the residuals at the conditions that fit best, and these D conditions' own, in standard
    deviations, insertion by insertion; `count_residuals` says how many belong to each. `whites` are
    (B, m, R), `scale` and `spread` (B,).
    """
    first, slopes = _stack(whites, group, scale, spread)
    stiff, best = _fit_conditions(first, slopes)
    found = np.concatenate([first + (best[:, None] @ slopes)[:, 0], best], axis=1)
    return found[:, _order(group, [white.shape[2] for white in whites])], _log_det(stiff)


def _fit_conditions(first: Floats, slopes: Floats) -> tuple[Floats, Floats]:
    """Return the precision (B, D, D) of the conditions, and those (B, D) that fit residuals (B, R) best."""
    stiff = np.eye(slopes.shape[1]) + slopes @ slopes.transpose(0, 2, 1)
    return stiff, np.asarray(-np.linalg.solve(stiff, slopes @ first[..., None])[..., 0])


def linearize_residuals(
    whites: Sequence[Floats],
    by: Sequence[Floats],
    group: NodeGroup,
    at: tuple[Floats, Floats],
    by_log_spread: Floats,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return `linear_residuals` and their derivatives (B, R + D, P) and (B, P), given those of white,
    (B, m, R, P).

    `at` are scale and spread; `by_log_spread` (P,) are the derivatives of the latter's logarithm.
    """
    first, slopes = _stack(whites, group, *at)
    by_first, by_slopes = _stack(by, group, *at)  # (B, R, P), (B, D, R, P)
    own: list[bool] = []  # which of the D conditions are a bevel's
    for nodes in group.nodes:
        own += [axis.of_bevel for axis in nodes.axes]
        own += [nodes.bevel and k == 0 for k in range(len(nodes.effects))]
    bevels = np.array([*own, *(surface[1] == BEVEL for surface in group.surfaces)], dtype=np.float64)
    by_slopes = by_slopes + (bevels[:, None] * slopes)[..., None] * by_log_spread
    stiff, best = _fit_conditions(first, slopes)
    sets, conditions, rows, free = by_slopes.shape
    flat = by_slopes.reshape(sets, conditions, rows * free)
    left = first + (best[:, None] @ slopes)[:, 0]  # (B, R)
    by_left = by_first + (best[:, None] @ flat).reshape(sets, rows, free)  # conditions held
    # derivative of the normal equations stiff @ best = -slopes @ first; terms in by_slopes @ left are not
    # zero off the optimum
    by_pull = (left[:, None, None] @ by_slopes)[:, :, 0] + slopes @ by_left  # (B, D, P)
    by_best = -np.linalg.solve(stiff, by_pull)
    weights = np.linalg.solve(stiff, slopes).reshape(sets, 1, conditions * rows)
    by_det = 2 * (weights @ by_slopes.reshape(sets, conditions * rows, free))[:, 0]
    order = _order(group, [white.shape[2] for white in whites])
    found = np.concatenate([left, best], axis=1)[:, order], _log_det(stiff)
    by_found = np.concatenate([by_left + slopes.transpose(0, 2, 1) @ by_best, by_best], axis=1)
    return *found, by_found[:, order], by_det


def count_residuals(group: NodeGroup, rows: Sequence[int]) -> list[int]:
    """Return how many of `linear_residuals` belong to each insertion of `rows` points' residuals.

    What insertions share stands behind the first of them.
    """
    counts = [row + size for row, size in zip(rows, _count_own(group), strict=True)]
    counts[0] += len(group.surfaces)
    return counts


def _stack(
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
    for k, (white, nodes, own, shared) in enumerate(members):
        rest = white.shape[2:]  # (R,) or (R, P)
        flat = white.reshape(sets, white.shape[1], math.prod(rest)) / scale[:, None, None]  # (B, m, R P)
        turned = weigh_linear(nodes, spread) @ flat  # (B, 1 + d, R P)
        at, here = slice(ends[k], ends[k + 1]), sizes[k]
        first[:, at] = turned[:, 0].reshape(sets, *rest)
        slopes[:, here : here + len(own), at] = (own[:, None] * turned[:, 1:]).reshape(sets, len(own), *rest)
        loads = load_effects(nodes, spread)  # (B, l)
        effects = loads[:, :, None] * (nodes.effects @ flat)
        here += len(own)
        slopes[:, here : here + loads.shape[1], at] = effects.reshape(sets, loads.shape[1], *rest)
        slopes[:, sizes[-1] :, at] = (shared.T @ turned[:, 1:]).reshape(sets, shared.shape[1], *rest)
    return first, slopes


def _count_own(group: NodeGroup) -> list[int]:
    return [len(nodes.axes) + len(nodes.effects) for nodes in group.nodes]


def _order(group: NodeGroup, rows: Sequence[int]) -> list[int]:
    """Return the places of residuals and conditions, (R,) and (D,), insertion by insertion."""
    found: list[int] = []
    whole, point = sum(rows), 0
    condition = whole
    for row, size in zip(rows, _count_own(group), strict=True):
        found += [*range(point, point + row), *range(condition, condition + size)]
        point, condition = point + row, condition + size
        if point == rows[0]:
            shared = whole + sum(_count_own(group))
            found += range(shared, shared + len(group.surfaces))
    return found


def _log_det(stiff: Floats) -> Floats:
    with np.errstate(invalid="ignore"):  # of a NaN
        found: Floats = np.linalg.slogdet(stiff)[1]
    return found
