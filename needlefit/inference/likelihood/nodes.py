"""The conditions under which one insertion is simulated: as measured, and with each uncertain one moved.

Uncertain are depths and the bevel (docs/inference.md, sections 4 and 6). Effects of two errors add up:

    r(t) = r(0) + sum_j ( r(t_j along axis j) - r(0) ),      t in standard deviations, d of them

and each term is a line through simulated nodes: r(t) = sum_k phi_k(t) r_k.
"""

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from needlefit.arrays import Floats, Ints
from needlefit.datasets.insertion import Insertion, split_boundary_sd

DepthTreatment = Literal["fixed", "linear"]

#: depths, in SDs from the measured one, at which an uncertain depth is simulated besides
DEPTH_STEPS_SD = (-1.0, 1.0)
#: numbers in place of a layer's, where something else is shared
FRAME = -1  #: number of the tracker's frame
BEVEL = -2  #: number of the bevel of one insertion that was measured at several depths
GROUP_SLOPE = -3  #: number of the slope of a group of runs
CARRIED = -4  #: number of the share of the guide's displacement that the tissue follows in a set-up
ROLL_STEP_DEG = 5.0  #: change of a bevel's roll (degrees), to both sides, by which its effect is simulated
BEVEL_STEP = 0.1  #: relative change of the bevel's offset, to both sides, by which its effect is simulated
MIN_GAP_MM = 1e-3  #: smallest distance (mm) of moved boundaries from each other and from the entry


@dataclass(frozen=True)
class ErrorAxis:
    """An uncertain depth: t = own * e + shared * z with e and z of unit variance."""

    #: own, shared: deviations of the insertion's own part and of the one that others have too; their squares
    #: sum to 1
    own: float = 1.0
    shared: float = 0.0
    #: what z belongs to: a specimen and two layers, or `FRAME` and a part of a tracker's frame, or
    #: `GROUP_SLOPE` and a group of runs, or `CARRIED` and a set-up, or `BEVEL` and the number of an
    #: insertion, whose t is the deviation of its bevel in SDs between insertions; empty where nothing is
    #: shared
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
    effects: Floats  #: (l, m + c) takes them to the effects of the bevel and the pose, which are no axes
    bevel: bool  #: whether the first effect is the bevel's

    def share_bevel(self, insertion: tuple[str, int]) -> "Nodes":
        """Return the nodes with the bevel as an axis: that of an insertion, by specimen and number in it."""
        specimen, number = insertion
        axis = ErrorAxis(0.0, 1.0, (specimen, BEVEL, number))
        linear = np.vstack([self.linear, self.effects[:1]])
        effects = self.effects[1:]
        return replace(self, axes=(*self.axes, axis), linear=linear, effects=effects, bevel=False)


def make_nodes(
    insertion: Insertion,
    s: Floats,
    depths: DepthTreatment,
    *,
    bevel: bool = False,
    constants: int = 0,
    along: tuple[ErrorAxis, ...] = (),
    roll_sd_deg: float = 0.0,
) -> Nodes:
    """Return the nodes of an insertion whose measured points have beam coordinates `s` (K,).

    With `bevel` its offset may differ from that of other insertions. `constants` curves stand behind those of
    the nodes; the last of these lie along the axes `along`. `roll_sd_deg`: SD of the bevel's roll in a run.
    """
    pairs: list[tuple[ErrorAxis | None, float, list[tuple[Insertion, Floats]]]] = []
    for axis, boundaries, depth in _list_depth_errors(insertion) if depths == "linear" else ():
        moved = [shift_depths(insertion, s, t * boundaries, t * depth) for t in DEPTH_STEPS_SD]
        pairs.append((axis, 0.5, moved))
    if roll_sd_deg:
        both = [(roll_bevel(insertion, step), s) for step in (-ROLL_STEP_DEG, ROLL_STEP_DEG)]
        pairs.append((ErrorAxis(), 0.5 * roll_sd_deg / ROLL_STEP_DEG, both))
    if bevel:
        factors = (insertion.bevel_factor * (1 + step) for step in (-BEVEL_STEP, BEVEL_STEP))
        pairs.append(
            (None, 0.5 / BEVEL_STEP, [(replace(insertion, bevel_factor=node), s) for node in factors])
        )
    insertions, places = zip((insertion, s), *(node for *_, both in pairs for node in both), strict=True)
    curves = np.eye(len(insertions) + constants)
    rows = [curves[0]]
    last = 0
    for _, weight, changed in pairs:  # differences from what was changed the other way
        last += len(changed)
        rows.append(weight * (curves[last] - curves[last - 1]))
    axes = [axis for axis, *_ in pairs if axis is not None]
    behind, apart = 1 + len(axes), len(curves) - len(along)  # the last constant curves lie along axes
    linear = np.array([*rows[:behind], *curves[apart:]])
    effects = np.array([*rows[behind:], *curves[len(insertions) : apart]]).reshape(-1, len(curves))
    return Nodes(insertions, np.array(places), (*axes, *along), linear, effects, bevel)


def roll_bevel(insertion: Insertion, angle: float) -> Insertion:
    """Return an insertion whose bevel was turned by an angle (degrees) before it and all along."""
    turns = (
        insertion.turns
        if insertion.turns[:1] and insertion.turns[0][0] == 0
        else ((0.0, 0.0), *insertion.turns)
    )
    return replace(insertion, turns=tuple((depth, roll + angle) for depth, roll in turns))


Surface = tuple[object, ...]


def list_surfaces(insertion: Insertion) -> list[tuple[str, int, int]]:
    """Return which surface of its specimen each boundary is: the layers that it parts say it."""
    pairs = zip(insertion.sequence, insertion.sequence[1:], strict=False)
    return [(insertion.specimen, min(pair), max(pair)) for pair in pairs]


def _list_depth_errors(insertion: Insertion) -> list[tuple[ErrorAxis, Floats, float]]:
    """Return each axis, and what a standard deviation along it adds to boundaries (n - 1,) and depth, mm."""
    count = len(insertion.boundaries)
    depth_errors: list[tuple[ErrorAxis, Floats, float]] = []
    if insertion.depth_sd > 0:
        depth_errors.append((ErrorAxis(), np.full(count, insertion.depth_sd), insertion.depth_sd))
    if insertion.boundary_sd > 0:
        shared, own_sd = split_boundary_sd(insertion)
        whole = float(np.hypot(shared, own_sd))
        for row, surface in zip(whole * np.eye(count), list_surfaces(insertion), strict=True):
            # the depth of a surface that is crossed again may err otherwise: sheets are crossed once
            again = any(axis.surface == surface for axis, *_ in depth_errors)
            axis = ErrorAxis(own_sd / whole, shared / whole, surface) if shared and not again else ErrorAxis()
            depth_errors.append((axis, row, 0.0))
    return depth_errors


def shift_depths(
    insertion: Insertion, s: Floats, boundaries: Floats, depth: float
) -> tuple[Insertion, Floats]:
    """Return the insertion with shifted depths, boundaries kept in order, and shifted coordinates."""
    boundaries_in_order = enforce_order(insertion.boundaries + boundaries)
    return replace(insertion, boundaries=boundaries_in_order, depth=insertion.depth + depth), s + depth


def enforce_order(boundaries: Floats) -> Floats:
    """Return boundary depths (..., n - 1), mm, raised where they are out of order or above the entry."""
    # subtracting the gaps first makes the running maximum keep them
    least = MIN_GAP_MM * np.arange(1, boundaries.shape[-1] + 1)
    raised: Floats = np.maximum.accumulate(np.maximum(boundaries - least, 0.0), axis=-1)
    return least + raised


@dataclass(frozen=True)
class NodeGroup:
    """Insertions whose depths err together, as the surfaces of one specimen do, or whose bevels do."""

    nodes: tuple[Nodes, ...]
    #: the k that at least two of them share: surfaces that they cross, bevels of one at several depths
    surfaces: tuple[tuple[str, int, int | str], ...]
    centred: bool = False  #: whether the bevels among these are deviations from their mean, which sum to zero

    @cached_property
    def bevels(self) -> Floats:
        """Which of the shared ones are bevels, 1 or 0: (k,)."""
        return np.array([float(surface[1] == BEVEL) for surface in self.surfaces])

    @cached_property
    def own(self) -> tuple[Floats, ...]:
        """Deviations (d,) of the own part of each insertion's depths."""
        return tuple(np.array([self._split(axis)[0] for axis in node.axes]) for node in self.nodes)

    @cached_property
    def shared(self) -> tuple[Floats, ...]:
        """What a standard deviation of each surface adds to each insertion's depths: (d, k)."""
        rows = []
        for node in self.nodes:
            shares = np.zeros((len(node.axes), len(self.surfaces)))
            for row, axis in zip(shares, node.axes, strict=True):
                row += self._split(axis)[1] * np.array([axis.surface == surface for surface in self.surfaces])
            rows.append(shares)
        return tuple(rows)

    @cached_property
    def members(self) -> "tuple[tuple[NodeGroup, Ints], ...]":
        """Each insertion by itself, with the surfaces that it shares, and their places among all."""
        members_of_groups = []
        for nodes, shared in zip(self.nodes, self.shared, strict=True):
            places = np.flatnonzero(shared.any(axis=0))
            members_of_groups.append((NodeGroup((nodes,), tuple(self.surfaces[k] for k in places)), places))
        return tuple(members_of_groups)

    @cached_property
    def parts(self) -> "tuple[tuple[tuple[int, ...], NodeGroup], ...]":
        """Insertions that share surfaces, with their places; parts are joined by the sum of bevels alone."""
        if not self.centred:
            return ((tuple(range(len(self.nodes))), self),)
        parts = list[tuple[list[int], set[object]]]()
        for place, node in enumerate(self.nodes):
            crossed: set[object] = {axis.surface for axis in node.axes if axis.surface in self.surfaces}
            joined = [part for part in parts if part[1] & crossed]
            places = [place for part in joined for place in part[0]]
            parts = [part for part in parts if part not in joined]
            parts.append(([*places, place], crossed.union(*(surfaces for _, surfaces in joined))))
        return tuple((tuple(places), self._take(places, crossed)) for places, crossed in parts)

    def _take(self, places: Sequence[int], crossed: Collection[object]) -> "NodeGroup":
        surfaces = tuple(surface for surface in self.surfaces if surface in crossed)
        return NodeGroup(tuple(self.nodes[place] for place in places), surfaces)

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
    """
    crossed = [{axis.surface for axis in node.axes if axis.surface} for node in nodes]
    bevels = {axis.surface for node in nodes for axis in node.axes if axis.of_bevel}
    counts = Counter(surface for surfaces in crossed for surface in surfaces)
    groups: dict[object, list[int]] = {}
    for place, surfaces in enumerate(crossed):
        twice = {surface for surface in surfaces if counts[surface] > 1}
        key = BEVEL if centred and surfaces & bevels else next(iter(twice))[0] if twice else place
        groups.setdefault(key, []).append(place)
    node_groups = []
    for members in groups.values():
        crossed_surfaces = sorted({surface for place in members for surface in crossed[place]})
        shared = tuple(
            surface for surface in crossed_surfaces if counts[surface] > 1 or (centred and surface in bevels)
        )
        some = tuple(nodes[place] for place in members)
        node_groups.append(
            (tuple(members), NodeGroup(some, shared, centred and not bevels.isdisjoint(shared)))
        )
    return tuple(node_groups)


def make_group(nodes: Nodes) -> NodeGroup:
    """Return the group of one insertion, which shares nothing."""
    return NodeGroup((nodes,), ())
