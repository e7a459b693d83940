"""Compute the density of whitened residuals, marginalised over uncertain depths, bevel and pose.

Their effects are taken as linear.

`white` (m, R) are the residuals at the m nodes of one insertion, and behind them the constant curves of its
pose. All that the density needs of them is their products G = white white^T. `scale` multiplies the
deviations of the points' noise, not those of pose and depths; `spread` is the bevel CV between insertions.
The insertions of a `NodeGroup` share errors of depth, or a bevel. A solve that failed is NaN, and so is what
comes of it.
"""

import math
from collections.abc import Iterator, Sequence

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
    size, surfaces = 1 + len(group.surfaces) + group.centred, np.arange(len(group.surfaces))
    total, log_det = np.zeros((len(scale), size, size)), _begin_log_det(group, scale)
    for block in group.blocks:
        part, own_det = _sum_over_group([products[k] for k in block.members], block.group, spread)
        at = np.array([0, *(1 + block.places)])
        # a block without a bevel has a condition less; its row and column of zeros change nothing
        parted = np.zeros((len(scale), block.bevels + len(at), block.bevels + len(at)))
        parted[:, : part.shape[1], : part.shape[1]] = part
        if block.bevels:
            stiff, row = 1 + parted[:, 1, 1], np.delete(parted[:, 1], 1, axis=1)
            row[:, len(part[0]) - 1 :] = 1.0  # of the condition that they sum to zero
            parted = np.delete(np.delete(parted, 1, axis=1), 1, axis=2)
            parted = parted - row[:, :, None] * row[:, None] / stiff[:, None, None]
            own_det = own_det + np.log(stiff)
        total[:, at[:, None], at] += parted
        log_det = log_det + own_det
    # completing the square in what is shared: its precision is stiff, its mean solve(stiff, -pull)
    stiff, pull = total[:, 1:, 1:], total[:, 1:, 0]
    stiff[:, surfaces, surfaces] += 1.0
    gained = np.sum(pull * np.linalg.solve(stiff, pull[..., None])[..., 0], axis=1)
    return density - 0.5 * (total[:, 0, 0] - gained + log_det + _log_det(stiff))


def _begin_log_det(group: NodeGroup, scale: Floats) -> Floats:
    """Return what the log det (B,) has before all blocks: the condition on N bevels is not of unit length."""
    return np.full(len(scale), -math.log(len(group.bevels)) if group.centred else 0.0)


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
    at: tuple[Floats, Floats],
    by_log_spread: Floats,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return residuals (B, R + D) and log det (B,) of the density, -(|residuals|^2 + log det) / 2, and their
    derivatives (B, R + D, P) and (B, P), given those of white, (B, m, R, P).

    The residuals are those at the conditions that fit best, and these D conditions' own, in standard
    deviations, insertion by insertion; `count_residuals` says how many belong to each. `at` are scale and
    spread; `by_log_spread` (P,) are the derivatives of the latter's logarithm.
    """
    sets, free = len(at[0]), by[0].shape[-1]
    # The conditions of a block are met by the others in the surfaces and in the sum of all bevels alone.
    # With those at last, the precision of all conditions is block-diagonal with a border.
    size, surfaces = len(group.surfaces) + group.centred, np.arange(len(group.surfaces))
    corner, pull = np.zeros((sets, size, size)), np.zeros((sets, size))
    corner[:, surfaces, surfaces] = 1.0
    log_det, blocks = _begin_log_det(group, at[0]), []
    for block in group.blocks:
        first, slopes = stack_residuals([whites[k] for k in block.members], block.group, *at)
        by_first, by_slopes = stack_residuals([by[k] for k in block.members], block.group, *at)
        bevels = np.array(_list_bevel_conditions(block.group), dtype=np.float64)
        by_slopes = by_slopes + (bevels[:, None] * slopes)[..., None] * by_log_spread
        count = slopes.shape[1] - len(block.group.surfaces) + block.bevels  # conditions of its own
        own, others = slopes[:, :count], slopes[:, count:]
        held = np.zeros((sets, len(block.places), first.shape[1]))  # of the sum there are no residuals
        held[:, : others.shape[1]] = others
        border = own @ held.transpose(0, 2, 1)  # (B, count, places)
        if count:
            border[:, -1, others.shape[1] :] = 1.0
        stiff = np.eye(count) + own @ own.transpose(0, 2, 1)
        pulled = np.concatenate([(own @ first[..., None]), border, own], axis=2)
        solved = np.linalg.solve(stiff, pulled)
        to_pull, to_border, to_own = np.split(solved, [1, 1 + len(block.places)], axis=2)
        places = block.places[:, None], block.places
        corner[:, *places] += held @ held.transpose(0, 2, 1) - border.transpose(0, 2, 1) @ to_border
        pull[:, block.places] += (held @ first[..., None] - border.transpose(0, 2, 1) @ to_pull)[..., 0]
        log_det = log_det + _log_det(stiff)
        blocks.append((first, own, held, border, stiff, to_pull, to_border, to_own, by_first, by_slopes))
    inverse, log_det = np.linalg.inv(corner), log_det + _log_det(corner)
    best = -(inverse @ pull[..., None])[..., 0]  # (B, size)
    by_pull, by_det, parts = np.zeros((sets, size, free)), np.zeros((sets, free)), []
    for block, known in zip(group.blocks, blocks, strict=True):
        first, own, held, border, stiff, to_pull, to_border, to_own, by_first, by_slopes = known
        shared = len(held[0]) - (group.centred and block.bevels)
        fits = np.concatenate([-(to_pull + to_border @ best[:, block.places, None])[..., 0],
                               best[:, block.places[:shared]]], axis=1)  # fmt: skip
        slopes = np.concatenate([own, held[:, :shared]], axis=1)
        rows, conditions = first.shape[1], slopes.shape[1]
        left = first + (fits[:, None] @ slopes)[:, 0]  # (B, R)
        flat = by_slopes.reshape(sets, conditions, rows * free)
        by_left = by_first + (fits[:, None] @ flat).reshape(sets, rows, free)  # conditions held
        # derivative of the normal equations stiff @ best = -slopes @ first; terms in by_slopes @ left are not
        # zero off the optimum
        by_own = (left[:, None, None] @ by_slopes)[:, :, 0] + slopes @ by_left  # (B, D, P)
        own_count = own.shape[1]
        by_best = np.linalg.solve(stiff, by_own[:, :own_count])
        by_pull[:, block.places[:shared]] += by_own[:, own_count:]
        by_pull[:, block.places] -= border.transpose(0, 2, 1) @ by_best
        inner = inverse[:, block.places[:, None], block.places]
        weights = inner @ (held - border.transpose(0, 2, 1) @ to_own)
        weights = np.concatenate([to_own - to_border @ weights, weights[:, :shared]], axis=1)
        flat = weights.reshape(sets, 1, conditions * rows)
        by_det = by_det + 2 * (flat @ by_slopes.reshape(sets, conditions * rows, free))[:, 0]
        parts.append((left, fits[:, :own_count], by_left, by_best, slopes, to_border))
    by_shared = -(inverse @ by_pull)
    found: dict[int, list[tuple[Floats, Floats]]] = {}
    together: list[tuple[Floats, Floats]] = []
    for block, (left, fits, by_left, by_best, slopes, to_border) in zip(group.blocks, parts, strict=True):
        by_best = -by_best - to_border @ by_shared[:, block.places]
        shared = slopes.shape[1] - fits.shape[1]
        by_all = np.concatenate([by_best, by_shared[:, block.places[:shared]]], axis=1)
        by_left = by_left + slopes.transpose(0, 2, 1) @ by_all
        row = condition = 0
        for k, own_count in zip(block.members, _count_own(block.group), strict=True):
            rows = slice(row, row + whites[k].shape[2])
            conditions = slice(condition, condition + own_count)
            found[k] = [(left[:, rows], by_left[:, rows]), (fits[:, conditions], by_best[:, conditions])]
            row, condition = rows.stop, conditions.stop
        together.append((fits[:, condition:], by_best[:, condition:]))
    together.append((best[:, surfaces], by_shared[:, surfaces]))
    found[0] += together
    pairs = [pair for k in sorted(found) for pair in found[k]]
    residuals, by_residuals = (np.concatenate(side, axis=1) for side in zip(*pairs, strict=True))
    return residuals, log_det, by_residuals, by_det


def _list_bevel_conditions(group: NodeGroup) -> list[bool]:
    """Return which of the conditions are a bevel's."""
    found: list[bool] = []
    for nodes in group.nodes:
        found += [axis.of_bevel for axis in nodes.axes]
        found += [nodes.bevel and k == 0 for k in range(len(nodes.effects))]
    return [*found, *(surface[1] == BEVEL for surface in group.surfaces)]


def count_residuals(group: NodeGroup, rows: Sequence[int]) -> list[int]:
    """Return how many of `linearize_residuals` belong to each insertion of `rows` points' residuals.

    What insertions share stands behind the first of them.
    """
    counts = [row + size for row, size in zip(rows, _count_own(group), strict=True)]
    counts[0] += len(group.surfaces) + len(group.bevels)
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


def _log_det(stiff: Floats) -> Floats:
    with np.errstate(invalid="ignore"):  # of a NaN
        found: Floats = np.linalg.slogdet(stiff)[1]
    return found
