"""Simulate many insertions with many parameter sets: vector instructions within one, threads between."""

from collections.abc import Sequence

import numpy as np

from needlefit.arrays import Bools, Floats
from needlefit.mechanics import native
from needlefit.mechanics.batch import VARYING_FIELDS, Batch, NeedleShapes
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.linearize import Jacobians, find_columns, read_jacobians
from needlefit.mechanics.prepared import Evaluation, PreparedInsertion, run_evaluations
from needlefit.mechanics.validity import compute_batch_scales
from needlefit.project.threads import count_cores
from needlefit.schemas.limits import MAX_NUMBER


def simulate_batches(batches: Sequence[Batch], threads: int | None = None) -> tuple[NeedleShapes, ...]:
    """Simulate every parameter set of every batch on all cores, the longest insertions first.

    What a set gives does not depend on the sets beside it, on their order, or on the number of threads.

    Parameters
    ----------
    threads : int, optional
        By default as many as there are cores.

    Returns
    -------
    tuple of NeedleShapes
        In the order of `batches`; sets that failed are NaN and say why in `status`. Numbers that are no
        parameters (not finite, mu not above 0, a guide out of the needle's reach) count as "non-finite".

    Raises
    ------
    ModelError
        If a needle is too short for its steps.
    """
    return tuple(_read_shapes(*pair) for pair in _run(batches, None, threads))


def linearize_batches(
    batches: Sequence[Batch], wrt: Sequence[str], threads: int | None = None
) -> tuple[tuple[NeedleShapes, Jacobians], ...]:
    """Simulate as `simulate_batches` does, and differentiate every shape.

    Parameters
    ----------
    wrt : sequence of str
        Kinds of parameters, as `linearize` takes them.

    Returns
    -------
    tuple of (NeedleShapes, Jacobians)
        Solved to `MAX_TOLERANCE_MM` at least; what a set gives is what `linearize_steps` gives.

    Raises
    ------
    ModelError
        If a needle is too short for its steps, or there is no such kind of parameter.
    """
    pairs = [(*pair, _read_shapes(*pair)) for pair in _run(batches, tuple(wrt), threads)]
    return tuple((shapes, read_jacobians(one, shapes.converged)) for _, one, shapes in pairs)


def _run(
    batches: Sequence[Batch], wrt: tuple[str, ...] | None, threads: int | None
) -> list[tuple[Batch, Evaluation]]:
    evaluations = [_evaluate(batch, wrt) for batch in batches]
    run_evaluations(evaluations, threads or count_cores())
    return list(zip(batches, evaluations, strict=True))


def _evaluate(batch: Batch, wrt: tuple[str, ...] | None) -> Evaluation:
    """Return the sets of a batch, of an insertion that is prepared once for all batches of `with_sets`."""
    valid = _find_valid(batch)
    if wrt not in batch.prepared:
        # depths and controls are alike in all valid sets: so one of them is used for all
        steps = batch.vary_inputs(int(np.argmax(valid)))[1] if valid.any() else batch.steps
        columns = None if wrt is None else find_columns(wrt, batch.tissue, steps, batch.rules)
        batch.prepared[wrt] = PreparedInsertion(
            batch.needle, batch.tissue, steps, batch.rules, columns=columns
        )
    insertion = batch.prepared[wrt]
    values = {name: getattr(batch, name) for name in VARYING_FIELDS if getattr(batch, name) is not None}
    if not valid.any():  # numbers that a needle may have, in place of what is none
        values = {name: _repeat_own(batch, name, array.shape) for name, array in values.items()}
    return Evaluation(insertion, len(batch), values, valid)


def _repeat_own(batch: Batch, name: str, shape: tuple[int, ...]) -> Floats:
    """Return the value that a batch's own tissue, needle or steps have, for all sets."""
    step = batch.steps[0]
    own = {
        "rigidity": batch.needle.flexural_rigidity,
        "offset": step.bevel.offset,
        "cut_angle": step.bevel.cut_angle,
        "base_y": step.controls.base_y,
        "base_slope": step.controls.base_slope,
        "guide_x": step.controls.guides[0].x if name == "guide_x" else 0.0,
    }
    return np.full(shape, own[name] if name in own else getattr(batch.tissue, name))


def _read_shapes(batch: Batch, evaluation: Evaluation) -> NeedleShapes:
    """Return the shapes of all sets."""
    a, valid = evaluation.shapes.arrays, evaluation.valid
    if not valid.all():
        wrong = ~valid
        a["status"][wrong], a["passes"][wrong] = native.NON_FINITE, 0
        a["u"][wrong] = a["slope"][wrong] = a["track"][wrong] = a["constraints"][wrong, 1:, 1] = np.nan
    scales = _make_scales(batch, valid, evaluation.insertion.depth)
    return NeedleShapes(
        a["x"], a["u"], a["slope"], a["constraints"], a["track"], a["status"], a["passes"], scales
    )


def _find_valid(batch: Batch) -> Bools:
    """Return which sets are made of numbers that a tissue or needle may have, (B,)."""
    good = np.ones(len(batch), dtype=bool)
    deepest = max(step.depth for step in batch.steps)
    for name in VARYING_FIELDS:
        values = getattr(batch, name)
        if values is not None:
            accepted = np.abs(values) <= MAX_NUMBER  # NaN compares as false
            if name in ("mu", "rigidity"):
                accepted &= values > 0
            if name == "shape":
                bounds = [one.bounds for one in LAWS[batch.tissue.law].parameters]
                low, high = np.array(bounds).reshape(-1, 2).T[:, :, None]  # (p, 1) each
                accepted &= (values >= low) & (values <= high)
            if name == "guide_x":  # before the tissue, and where the base does not come to it
                accepted &= (values < 0) & (values > deepest - batch.needle.length)
            good &= accepted.reshape(len(batch), -1).all(axis=1)
    return good


def _make_scales(batch: Batch, valid: Bools, depth: float) -> Floats:
    """Return what the validity of every set is measured by, (B, 3) mm."""
    count = len(batch)
    mu = np.broadcast_to(batch.tissue.mu, (count, batch.tissue.layers)) if batch.mu is None else batch.mu
    rigidity = batch.needle.flexural_rigidity if batch.rigidity is None else batch.rigidity
    mu, rigidity = np.where(valid[:, None], mu, np.nan), np.where(valid, rigidity, np.nan)
    return compute_batch_scales(mu, rigidity, batch.tissue, depth, batch.rules.spacing)
