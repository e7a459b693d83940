"""The conditions under which one insertion is simulated: as measured, and with each uncertain one moved.

Uncertain are the depths of boundaries, the entry, and the bevel of this insertion. A boundary's error has a
part of its own and one that its surface gives to every insertion of the specimen; an error of the entry moves
the tip and all boundaries alike. The effects of two errors add up almost exactly, so that

    r(t) = r(0) + sum_j ( r(t_j along axis j) - r(0) ),      t in standard deviations, d of them

and each term is a line or a spline through a few simulated nodes: r(t) = sum_k phi_k(t) r_k.

Depths may be integrated over by a product rule, whose table never forms its curves. With
r = r_0 + sum_j f_j(t_j), the square |r|^2 consists of products of pairs of f, so that a table over all d axes
is a sum of tables over one axis and over two. The rule is the trapezoid's, whose error on Gaussian integrands
vanishes faster than any power of its step. What insertions share, z, is integrated last: the table of each
insertion, folded along its axes with the distribution of t given z, is its likelihood at every z, and these
are multiplied.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from scipy.special import logsumexp

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, TipTrack, split_boundary_sd
from needlefit.errors import ConfigError

#: where each axis is simulated besides its centre, in standard deviations. Of several spacings tried on
#: synthetic insertions these came closest to brute force.
QUADRATURE_NODES = (-0.7, 0.7, -1.6, 1.6)
RANGE_SD = 3.2  #: standard deviations up to which each axis is integrated: 0.14 % of its prior lies beyond
#: most points of one axis, and of the whole table: with more than three axes they become fewer on each
MAX_AXIS_POINTS, MAX_TABLE_POINTS = 17, 30_000
#: most axes of one table, of 7 points each. Six have 5, which err by 0.08 in the log where a deviation of
#: each depth moves the curve by one whitened unit; eight err by 1, and by 3 at two units.
MAX_AXES = 5

#: entries of tables that are held at once: thousands of parameter sets must not take gigabytes
MAX_ENTRIES_AT_ONCE = 1_000_000


@dataclass(frozen=True)
class QuadratureRule:
    """A product quadrature rule over d axes of n points."""

    points: Floats  #: (n,) of each axis, in standard deviations
    log_weights: Floats  #: (n,) theirs under the prior
    #: (1 + d n, m) takes the curves at the m nodes to r_0 and to f_j at the n points of every axis
    steps: Floats
    axes: int  #: d


@lru_cache
def make_rule(axes: int) -> QuadratureRule:
    """Return the rule for d axes; nodes in the order: centre, then `QUADRATURE_NODES` of each axis.

    Along each axis f is a natural cubic spline through its nodes, straight beyond them.
    """
    count = _count_points(axes)
    t = _make_points(count)
    each = make_spline_weights(QUADRATURE_NODES, t)  # (n, 4)
    steps = np.zeros((1 + axes * count, 1 + axes * len(QUADRATURE_NODES)))
    steps[0, 0] = 1.0
    for j in range(axes):
        rows = slice(1 + j * count, 1 + (j + 1) * count)
        steps[rows, 1 + j * len(QUADRATURE_NODES) : 1 + (j + 1) * len(QUADRATURE_NODES)] = each
        # f_j is a difference from the centre curve, which is node 0
        steps[rows, 0] = -each.sum(axis=1)
    log_weights = -0.5 * t**2
    return QuadratureRule(t, log_weights - logsumexp(log_weights), steps, axes)


def _count_points(axes: int) -> int:
    return min(MAX_AXIS_POINTS, int(MAX_TABLE_POINTS ** (1 / axes)))


def _make_points(count: int) -> Floats:
    return np.linspace(-RANGE_SD, RANGE_SD, count)


@dataclass(frozen=True)
class TableAxis:
    """How one axis of a table is folded: onto the points of a shared error, or summed."""

    shared: int | None  #: number of the shared error; None where the insertion's error is its own
    fold: Floats  #: (n_z, n) probability of the axis' points given each z; one row where the axis is summed


def make_table_axes(rule: QuadratureRule, own: Floats, shared: Floats) -> tuple[TableAxis, ...]:
    """Return how the axes of an insertion are folded; `own` is (d,), `shared` (d, k) with one entry a row.

    Where its own part is narrower than the step of the rule, it counts as wide as half a step.
    """
    t, z = rule.points, _make_points(_count_points(shared.shape[1])) if shared.shape[1] else np.empty(0)
    found = []
    for sd, loads in zip(own, shared, strict=True):
        if not loads.any():
            found.append(TableAxis(None, np.exp(rule.log_weights)[None]))
            continue
        number = int(np.argmax(loads))
        width = max(float(sd), 0.5 * float(t[1] - t[0]))
        logs = -0.5 * ((t - loads[number] * z[:, None]) / width) ** 2
        found.append(TableAxis(number, np.exp(logs - logsumexp(logs, axis=1, keepdims=True))))
    return tuple(found)


def log_means(
    products: Sequence[Floats], rules: Sequence[QuadratureRule], axes: Sequence[tuple[TableAxis, ...]]
) -> Floats:
    """Return the log of the mean of prod_i exp(-|r_i|^2 / 2) over all depths, (B,).

    `products` (B, m, m) are those of the curves of each insertion at its nodes.
    """
    count = _count_shared(axes)
    largest = max(len(rule.points) ** rule.axes for rule in rules)
    step = max(1, MAX_ENTRIES_AT_ONCE // largest)
    found = np.empty(len(products[0]))
    for start in range(0, len(found), step):
        some = slice(start, start + step)
        total = _log_prior(count)[None]
        for part, rule, folds in zip(products, rules, axes, strict=True):
            total = total + _fold(_log_table(part[some], rule), folds, count)
        found[some] = logsumexp(total, axis=tuple(range(1, total.ndim)))
    return found


def moments(
    products: Sequence[Floats], rules: Sequence[QuadratureRule], axes: Sequence[tuple[TableAxis, ...]]
) -> list[Floats]:
    """Return of each insertion the posterior mean (m, m) of phi phi^T over the depths, r = sum_k phi_k r_k.

    `products` are (1, m, m) each.
    """
    count = _count_shared(axes)
    tables = [_log_table(part, rule) for part, rule in zip(products, rules, strict=True)]
    folded = [_fold(table, folds, count)[0] for table, folds in zip(tables, axes, strict=True)]
    total = _log_prior(count) + sum(folded)
    found = []
    for table, own, rule, folds in zip(tables, folded, rules, axes, strict=True):
        others = np.broadcast_to(np.exp(total - own - np.max(total - own)), total.shape)
        weights = np.exp(table[0] - table.max()) * _unfold(others, folds)
        found.append(_second_moments(weights / weights.sum(), rule))
    return found


def _count_shared(axes: Sequence[tuple[TableAxis, ...]]) -> int:
    return max((1 + axis.shared for folds in axes for axis in folds if axis.shared is not None), default=0)


def _log_prior(count: int) -> Floats:
    total = np.zeros(())
    if count:
        points = _make_points(_count_points(count))
        single = -0.5 * points**2 - logsumexp(-0.5 * points**2)
        for _ in range(count):
            total = total[..., None] + single
    return total


def _fold(table: Floats, axes: Sequence[TableAxis], count: int) -> Floats:
    """Return the log likelihood (B, n_z or 1, ...) at the points of `count` shared errors."""
    highest = table.max(axis=tuple(range(1, table.ndim)), keepdims=True)
    # log-sum-exp: exponentials of large squares would underflow to 0 together
    likely, count_sets = np.exp(table - highest), len(table)
    for axis in axes:  # one product a set, so that no set depends on those beside it
        sizes = likely.shape[2:]
        folded = axis.fold @ likely.reshape(count_sets, likely.shape[1], -1)
        likely = np.moveaxis(folded.reshape(count_sets, -1, *sizes), 1, -1)  # what is folded goes to the end
    order = [axis.shared for axis in axes]
    places = [1 + order.index(number) for number in sorted(one for one in order if one is not None)]
    summed = [1 + k for k, number in enumerate(order) if number is None]
    likely = likely.transpose(0, *places, *summed).reshape(count_sets, *[likely.shape[p] for p in places])
    with np.errstate(divide="ignore"):
        found: Floats = np.log(likely) + highest.reshape(len(table), *[1] * len(places))
    shape = [len(table), *[1] * count]
    for number, size in zip(sorted(one for one in order if one is not None), found.shape[1:], strict=True):
        shape[1 + number] = size
    return found.reshape(shape)


def _unfold(weights: Floats, axes: Sequence[TableAxis]) -> Floats:
    """Return the mean (n, ..., n) of the axes' probabilities over shared errors with `weights` (n_z, ...)."""
    numbers = [axis.shared for axis in axes if axis.shared is not None]
    weights = weights.sum(axis=tuple(k for k in range(weights.ndim) if k not in numbers))
    remaining = sorted(numbers)
    for axis in axes:
        if axis.shared is None:
            weights = weights[..., None] * axis.fold[0]
        else:
            place = remaining.index(axis.shared)
            remaining.pop(place)
            weights = np.tensordot(weights, axis.fold, axes=(place, 0))
    return weights


def _second_moments(weights: Floats, rule: QuadratureRule) -> Floats:
    """Return the mean (m, m) of phi phi^T over a table of weights (n, ..., n) that sum to 1."""
    count, axes = len(rule.points), rule.axes
    found = np.zeros((len(rule.steps), len(rule.steps)))
    found[0, 0] = 1.0
    places = [slice(1 + j * count, 1 + (j + 1) * count) for j in range(axes)]
    for j, place in enumerate(places):
        alone = weights.sum(axis=tuple(k for k in range(axes) if k != j))  # (n,)
        found[place, place] = np.diag(alone)
        found[0, place] = found[place, 0] = alone
        for i in range(j):
            pair = weights.sum(axis=tuple(k for k in range(axes) if k not in (i, j)))  # (n, n)
            found[places[i], place], found[place, places[i]] = pair, pair.T
    return rule.steps.T @ found @ rule.steps


def make_spline_weights(places: Sequence[float], t: Floats) -> Floats:
    """Return the weights (n, q) of curves at q `places` that give the curve at t (n,), all less that at 0.

    A natural cubic spline, straight beyond the outermost places.
    """
    order = np.argsort((0.0, *places))
    inner = np.array((0.0, *places))[order]
    from scipy.interpolate import CubicSpline  # late: it takes 0.3 s to load

    spline = CubicSpline(inner, np.eye(len(inner))[order], bc_type="natural")
    # beyond the outer nodes the spline goes on as a line: its cubic would run away
    held = np.clip(t, inner[0], inner[-1])
    return (spline(held) + spline(held, 1) * (t - held)[:, None])[:, 1:]


def _log_table(products: Floats, rule: QuadratureRule) -> Floats:
    """Return -|r|^2 / 2 at all points of the rule, (B, n, ..., n)."""
    count = len(rule.points)
    pairs = rule.steps @ products @ rule.steps.T  # (B, 1 + d n, 1 + d n)
    own = -pairs[:, 0, 1:] - 0.5 * np.diagonal(pairs, axis1=1, axis2=2)[:, 1:]
    table = -0.5 * pairs[:, 0, 0]
    for j in range(rule.axes):  # the table over the axes before grows by one
        place = slice(1 + j * count, 1 + (j + 1) * count)
        more = own[:, j * count : (j + 1) * count]  # (B, n)
        more = more.reshape(-1, *[1] * j, count)
        for i in range(j):
            cross = pairs[:, 1 + i * count : 1 + (i + 1) * count, place]  # (B, n, n)
            more = more - cross.reshape(-1, *[1] * i, count, *[1] * (j - i - 1), count)
        table = table[..., None] + more
    return table


DepthTreatment = Literal["fixed", "linear", "quadrature"]

NODE_POSITIONS_SD: dict[DepthTreatment, tuple[float, ...]] = {
    "fixed": (),
    "linear": (-1.0, 1.0),
    "quadrature": QUADRATURE_NODES,
}  #: where each axis is simulated besides its centre, in standard deviations
#: stand in place of a layer where what is shared is the tracker's frame, the bevel of one insertion that was
#: measured at several depths, or slope and response to the guide of a group of runs
FRAME, BEVEL, GROUP_SLOPE, GROUP_GAIN = -1, -2, -3, -4
#: part of the guide's moves by which they are changed to simulate their effect, to both sides
GAIN_STEP = 0.1
BEVEL_STEP = 0.1  #: part of the bevel's offset by which it is changed to simulate its effect, to both sides
MIN_GAP_MM = 1e-3  #: smallest distance, mm, of moved boundaries from each other and from the entry


@dataclass(frozen=True)
class ErrorAxis:
    """An uncertain depth: t = own * e + shared * z with e and z of unit variance."""

    #: own, shared: deviations of the insertion's own part and of the one that others have too; their squares
    #: sum to 1
    own: float = 1.0
    shared: float = 0.0
    #: what z belongs to: a specimen and two layers, or `FRAME` and a part of a tracker's frame, or
    #: `GROUP_SLOPE` or `GROUP_GAIN` and a group of runs, or `BEVEL` and the number of an insertion, whose t
    #: is the deviation of its bevel in SDs between insertions; empty where nothing is shared
    surface: tuple[str, int, int | str] | tuple[()] = ()

    @property
    def of_bevel(self) -> bool:
        """Whether it is the bevel of one insertion."""
        return self.surface[1:2] == (BEVEL,)


@dataclass(frozen=True)
class Nodes:
    """The m conditions under which one insertion is simulated; the first is as measured."""

    insertions: tuple[Insertion, ...]  #: with their boundaries, depth and bevel
    s: Floats  #: (m, K) beam coordinates of the measured points in each, mm
    axes: tuple[ErrorAxis, ...]  #: the d uncertain depths
    #: (1 + d, m + c) takes the curves r_k to r(0) and the slopes by t along the d axes. Behind the curves of
    #: the nodes stand c constant ones, what a unit deviation of the pose does.
    linear: Floats
    effects: Floats  #: (l, m + c) takes them to what acts linearly whatever `rule` says: the bevel, the pose
    bevel: bool  #: whether the first effect is the bevel's
    #: how the depths are integrated over; None where they act linearly. Of the first nodes alone.
    rule: QuadratureRule | None

    def share_bevel(self, insertion: tuple[str, int]) -> "Nodes":
        """Return the nodes with the bevel as an axis: that of an insertion, by specimen and number in it.

        Raises ConfigError if the depths are integrated over by quadrature.
        """
        if self.rule is not None:
            raise ConfigError(
                f"{self.insertions[0].id} is one of several depths of one insertion, which have one bevel",
                key="likelihood.depths",
                expected="depths that are not integrated over by quadrature",
                fix='write depths = "linear" in [likelihood] of the recipe',
            )
        specimen, number = insertion
        axis = ErrorAxis(0.0, 1.0, (specimen, BEVEL, number))
        linear = np.vstack([self.linear, self.effects[:1]])
        effects = self.effects[1:]
        return replace(self, axes=(*self.axes, axis), linear=linear, effects=effects, bevel=False)

    @cached_property
    def linear_only(self) -> "Nodes":
        """The nodes that a linear dependence on the depths needs."""
        count = len(self.insertions)
        used = np.flatnonzero(np.vstack([self.linear, self.effects]).any(axis=0))
        kept = tuple(self.insertions[k] for k in used if k < count)
        at = self.s[[k for k in used if k < count]]
        return Nodes(kept, at, self.axes, self.linear[:, used], self.effects[:, used], self.bevel, None)


def make_nodes(
    insertion: Insertion,
    s: Floats,
    depths: DepthTreatment,
    *,
    bevel: bool = False,
    constants: int = 0,
    shared: tuple[ErrorAxis, ...] = (),
    gain: tuple[ErrorAxis, float] | None = None,
) -> Nodes:
    """Return the nodes of an insertion whose measured points have beam coordinates `s` (K,).

    With `bevel` its offset may differ from that of other insertions. `constants` curves stand behind those of
    the nodes; the last of these lie along the axes `shared` with other insertions (not with depths by
    quadrature). `gain`: the axis and relative SD of a moved guide's effect (not with quadrature either).

    Raises ConfigError if the insertion has more uncertain depths than quadrature is right for.
    """
    places = NODE_POSITIONS_SD[depths]
    moves = _list_depth_errors(insertion) if places else []
    found = [(insertion, s)]
    for _, boundaries, depth in moves:
        found += [shift_depths(insertion, s, t * boundaries, t * depth) for t in places]
    axes = [axis for axis, *_ in moves]
    if gain is not None:
        axes.append(gain[0])
        found += [(scale_guide(insertion, 1 + step), s) for step in (-GAIN_STEP, GAIN_STEP)]
    if bevel:
        factors = (insertion.bevel_factor * (1 + step) for step in (-BEVEL_STEP, BEVEL_STEP))
        found += [(replace(insertion, bevel_factor=factor), s) for factor in factors]
    insertions, at = zip(*found, strict=True)
    linear = np.zeros((1 + len(axes) + len(shared), len(found) + constants))
    linear[0, 0] = 1.0
    for j in range(len(moves)):
        first = 1 + j * len(places)
        # central difference over the first two nodes of the axis, at -places[1] and +places[1]
        linear[1 + j, first : first + 2] = np.array([-0.5, 0.5]) / places[1]
    if gain is not None:
        first = 1 + len(moves) * len(places)
        linear[len(axes), first : first + 2] = np.array([-0.5, 0.5]) * gain[1] / GAIN_STEP
    apart = constants - len(shared)
    linear[1 + len(axes) :, len(found) + apart :] = np.eye(len(shared))
    effects = np.zeros((bevel + apart, len(found) + constants))
    if bevel:
        effects[0, len(found) - 2 : len(found)] = np.array([-0.5, 0.5]) / BEVEL_STEP
    effects[int(bevel) :, len(found) : len(found) + apart] = np.eye(apart)
    if depths == "quadrature":
        _check_axes(f"{insertion.id} has {len(moves)} uncertain depths", len(moves))
    integration = make_rule(len(moves)) if depths == "quadrature" and moves else None
    return Nodes(insertions, np.array(at), (*axes, *shared), linear, effects, bevel, integration)


def scale_guide(insertion: Insertion, factor: float) -> Insertion:
    """Return a tip track whose guide moved `factor` times as far from where it first stood."""
    assert isinstance(insertion, TipTrack)
    first = insertion.guide[0]
    return replace(insertion, guide=first + factor * (insertion.guide - first))


Surface = tuple[object, ...]


def draw_boundary_errors(
    insertion: Insertion, shared: dict[Surface, float], rng: np.random.Generator
) -> Floats:
    """Draw the errors (n - 1,) of an insertion's boundaries, mm.

    `shared` holds the errors of surfaces, in standard deviations; what is missing there is drawn and added.
    """
    common, own = split_boundary_sd(insertion)
    errors = own * rng.standard_normal(len(insertion.boundaries))
    for k, surface in enumerate(_list_surfaces(insertion)):
        if surface not in shared:
            shared[surface] = float(rng.standard_normal())
        errors[k] += common * shared[surface]
    return errors


def _list_surfaces(insertion: Insertion) -> list[tuple[str, int, int]]:
    """Return which surface of its specimen each boundary is: the layers that it parts say it."""
    pairs = zip(insertion.sequence, insertion.sequence[1:], strict=False)
    return [(insertion.specimen, min(pair), max(pair)) for pair in pairs]


def _list_depth_errors(insertion: Insertion) -> list[tuple[ErrorAxis, Floats, float]]:
    """Return each axis, and what a standard deviation along it adds to boundaries (n - 1,) and depth, mm."""
    count = len(insertion.boundaries)
    found: list[tuple[ErrorAxis, Floats, float]] = []
    if insertion.depth_sd > 0:
        found.append((ErrorAxis(), np.full(count, insertion.depth_sd), insertion.depth_sd))
    if insertion.boundary_sd > 0:
        shared, own = split_boundary_sd(insertion)
        whole = float(np.hypot(shared, own))
        for row, surface in zip(whole * np.eye(count), _list_surfaces(insertion), strict=True):
            # the depth of a surface that is crossed again may err otherwise: sheets are crossed once
            again = any(axis.surface == surface for axis, *_ in found)
            axis = ErrorAxis(own / whole, shared / whole, surface) if shared and not again else ErrorAxis()
            found.append((axis, row, 0.0))
    return found


def shift_depths(
    insertion: Insertion, s: Floats, boundaries: Floats, depth: float
) -> tuple[Insertion, Floats]:
    """Return the insertion with shifted depths, boundaries kept in order, and shifted coordinates."""
    found = enforce_order(insertion.boundaries + boundaries)
    return replace(insertion, boundaries=found, depth=insertion.depth + depth), s + depth


def enforce_order(boundaries: Floats) -> Floats:
    """Return boundary depths (n - 1,), mm, raised where they are out of order or above the entry."""
    # subtracting the gaps first makes the running maximum keep them
    least = MIN_GAP_MM * np.arange(1, len(boundaries) + 1)
    raised: Floats = np.maximum.accumulate(np.maximum(boundaries - least, 0.0))
    return least + raised


@dataclass(frozen=True)
class NodeGroup:
    """Insertions whose depths err together, as the surfaces of one specimen do."""

    nodes: tuple[Nodes, ...]
    surfaces: tuple[tuple[str, int, int | str], ...]  #: the k that at least two of them cross
    #: whether all bevels, which are then among `surfaces`, are deviations from their mean
    centred: bool = False

    @cached_property
    def own(self) -> tuple[Floats, ...]:
        """Deviations (d,) of the own part of each insertion's depths."""
        return tuple(np.array([self._split(axis)[0] for axis in one.axes]) for one in self.nodes)

    @cached_property
    def shared(self) -> tuple[Floats, ...]:
        """What a standard deviation of each surface adds to each insertion's depths: (d, k)."""
        bevels = np.array([surface[1] == BEVEL for surface in self.surfaces])
        found = []
        for one in self.nodes:
            shares = np.zeros((len(one.axes), len(self.surfaces)))
            for row, axis in zip(shares, one.axes, strict=True):
                row += self._split(axis)[1] * np.array([axis.surface == each for each in self.surfaces])
                if self.centred and axis.of_bevel:
                    row -= bevels / bevels.sum()
            found.append(shares)
        return tuple(found)

    def _split(self, axis: ErrorAxis) -> tuple[float, float]:
        """Return both deviations; what nobody else has is the insertion's own."""
        if axis.surface in self.surfaces:
            return axis.own, axis.shared
        return float(np.hypot(axis.own, axis.shared)), 0.0


def group_nodes(
    nodes: tuple[Nodes, ...], centred: bool = False
) -> tuple[tuple[tuple[int, ...], NodeGroup], ...]:
    """Return the groups of insertions that share surfaces, each with the places of its members in `nodes`.

    With `centred`, the deviations of all bevels sum to zero, so that all that have one are in one group.

    Raises ConfigError if they share more errors than quadrature, where that is asked for, is right for.
    """
    crossed = [{axis.surface for axis in one.axes if axis.surface} for one in nodes]
    bevels = {axis.surface for one in nodes for axis in one.axes if axis.of_bevel and centred}
    groups: dict[object, list[int]] = {}
    for place, surfaces in enumerate(crossed):
        others = set().union(*(more for k, more in enumerate(crossed) if k != place))
        common = surfaces & others
        key = BEVEL if surfaces & bevels else next(iter(common))[0] if common else place
        groups.setdefault(key, []).append(place)
    found = []
    for members in groups.values():
        counted = [surface for place in members for surface in sorted(crossed[place])]
        common = {surface for surface in counted if counted.count(surface) > 1 or surface in bevels}
        group = NodeGroup(tuple(nodes[place] for place in members), tuple(sorted(common)), centred)
        if any(one.rule is not None for one in group.nodes):
            ids = ", ".join(one.insertions[0].id for one in group.nodes)
            _check_axes(f"{ids} share {len(common)} errors of boundaries", len(common))
        found.append((tuple(members), group))
    return tuple(found)


def _check_axes(what: str, axes: int) -> None:
    if axes > MAX_AXES:
        raise ConfigError(
            f"{what}, too many to integrate over by quadrature",
            key="likelihood.depths",
            expected=f"at most {MAX_AXES} with depths by quadrature",
            fix='write depths = "linear" in [likelihood] of the recipe, or state fewer uncertain depths',
        )


def make_group(nodes: Nodes) -> NodeGroup:
    """Return the group of one insertion, which shares nothing."""
    return NodeGroup((nodes,), ())
