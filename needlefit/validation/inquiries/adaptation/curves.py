"""Curves over the number of insertions learned from, and from where on they are good enough."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from needlefit.project.streams import stream
from needlefit.validation.inquiries.adaptation.reached import Again, drawn_again, estimate, reached
from needlefit.validation.inquiries.adaptation.task import Task, learned_from
from needlefit.validation.inquiries.answered import Frames
from needlefit.validation.score import Row

Floats = NDArray[np.float64]

WAYS = ("inflated", "new", "none")

ERRORS = ("te_mm", "ipe_mean_mm")
"""What a count of insertions is asked of."""

MEASURES = (*ERRORS, "tip_crps_mm", "shape_crps_mm", "tip_in_50", "tip_in_95", "shape_in_95")
"""What becomes a curve: means over the held-out needles."""


def conclude(task: Task, frames: Frames) -> tuple[str, ...]:
    """Add `orders`, `curves`, `adaptation`, `reached` and `gained` to the frames; return the faults."""
    curves = pd.DataFrame(list(_curves(task, frames["errors"])))
    frames["orders"] = pd.DataFrame(
        [
            {"order": k, "n": n, "insertion": one}
            for k, order in enumerate(task.orders)
            for n, one in enumerate(order, start=1)
        ]
    )
    frames["curves"] = curves
    means = _over_orders(curves).merge(_learned(frames["fits"]), on=["way", "n"], how="left")
    floors = {error: float(frames["errors"][f"floor_{error}"].astype(float).mean()) for error in ERRORS}
    frames["adaptation"] = means.assign(**{f"floor_{error}": floor for error, floor in floors.items()})
    rng = stream(task.new.recipe.seed, task.new.name, "drawn again")
    again = drawn_again(len(task.orders), len(task.held_out), rng)
    frames["reached"] = pd.DataFrame(list(_reached(task, frames["errors"], again)))
    frames["gained"] = pd.DataFrame(list(_gained(task, frames["errors"], again)))
    return _faults(frames)


def _curves(task: Task, errors: pd.DataFrame) -> Iterator[Row]:
    """Yield every order's mean errors over the held-out needles, for each way and count."""
    numbers = errors.assign(**{name: errors[name].astype(float) for name in MEASURES})
    means = numbers.groupby(["way", "learned_from"], sort=False)[list(MEASURES)].mean()
    known = {key: means.loc[key].to_dict() for key in means.index}
    for way in WAYS:
        for order, ids in enumerate(task.orders):
            for n in task.counts:
                name = "nothing" if way == "none" else learned_from(ids, n)
                if (way, name) in known:
                    yield {"way": way, "order": order, "n": n} | known[way, name]


def _over_orders(curves: pd.DataFrame) -> pd.DataFrame:
    """Return mean, median and range over orders of the errors, and the mean of all else."""
    grouped = curves.groupby(["way", "n"], sort=False)
    found = grouped[list(MEASURES)].mean()
    for error in ERRORS:
        for what in ("median", "min", "max"):
            found[error.replace("_mm", f"_{what}_mm")] = grouped[error].agg(what)
    return found.reset_index()


def _learned(fits: pd.DataFrame) -> pd.DataFrame:
    """Return how many sets of insertions were learned from, and how well their draws can be trusted."""
    each = fits.drop_duplicates(["way", "learned_from"]).astype({"pareto_k": float, "sampled": bool})
    by = each.groupby(["way", "n"], sort=False)
    return by.agg(
        sets=("learned_from", "size"), worst_pareto_k=("pareto_k", "max"), sampled=("sampled", "sum")
    )


def _means(task: Task, errors: pd.DataFrame, way: str, error: str, again: Again) -> Floats:
    """Return the mean errors (R, N) of a way at every count, as they are and drawn again."""
    wanted = errors[errors["way"] == way].astype({error: float})
    table = wanted.pivot(index="learned_from", columns="insertion", values=error)
    ids = [one.id for one in task.held_out]
    sets = [
        ["nothing" if way == "none" else learned_from(order, n) for n in task.counts] for order in task.orders
    ]
    known = table.reindex([name for names in sets for name in names])[ids].to_numpy(dtype=np.float64)
    return again.means(known.reshape(len(task.orders), len(task.counts), len(ids)))


def _reached(task: Task, errors: pd.DataFrame, again: Again) -> Iterator[Row]:
    """Yield from which count on each way stays near what all new ones give, and near the floor."""
    for error in ERRORS:
        means = {way: _means(task, errors, way, error, again) for way in WAYS}
        floors = _means(task, errors, "none", f"floor_{error}", again)[:, 0]
        for target, levels in (("all", means["new"][:, -1]), ("floor", floors)):
            limits = levels + task.record.margin_mm
            for way in WAYS:
                known = np.isfinite(means[way][0])  # from new insertions alone nothing is known at 0
                counts = [n for n, there in zip(task.counts, known, strict=True) if there]
                found = reached(means[way][:, known], counts, limits)
                about = {"way": way, "measure": error, "target": target, "target_mm": float(levels[0])}
                counted = {"n": found.value, "n_low": found.low, "n_high": found.high}
                yield {**about, "limit_mm": float(limits[0]), **counted}


def _gained(task: Task, errors: pd.DataFrame, again: Again) -> Iterator[Row]:
    """Yield by how much the inflated posterior errs less than each rival, count by count."""
    for error in ERRORS:
        mine = _means(task, errors, "inflated", error, again)
        for rival in ("new", "none"):
            gain = _means(task, errors, rival, error, again) - mine
            for k, n in enumerate(task.counts):
                if np.isfinite(gain[0, k]):
                    found = estimate(gain[:, k])
                    about = {"measure": error, "rival": rival, "n": n, "gain_mm": found.value}
                    yield {**about, "gain_low_mm": found.low, "gain_high_mm": found.high}


def _faults(frames: Frames) -> tuple[str, ...]:
    errors = frames["errors"]
    failed = int((~errors["converged"].astype(bool)).sum())
    untold = int(errors["tip_crps_mm"].isna().sum())
    return (
        *((f"{failed} simulations of held-out insertions did not converge",) if failed else ()),
        *((f"{untold} held-out insertions could not be foretold",) if untold else ()),
    )
