"""What predictions in a specimen that was not tuned on know of it: its parameters differ from those fitted.

By how much is learned from all specimens of the dataset but that one which have as many layers, together with
what the recipe states; each is fitted by itself, by some of its insertions.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.inference import specimens
from needlefit.project.progress import never_stop
from needlefit.project.tasks import TaskPool, TaskStop, run_parts
from needlefit.studies.folds import Fold
from needlefit.studies.job import Job
from needlefit.studies.score import Row

#: insertions of a specimen that its estimate uses, the deepest and others evenly over depths
MAX_INSERTIONS = 4


@dataclass
class NewSpecimens:
    """The spreads that predictions of a fold use; they and the estimates of specimens are kept."""

    job: Job
    fold: Fold
    theta: Floats  #: (P,) the fit, from which the estimates are searched
    estimates: dict[str, specimens.SpecimenEstimate | None] = field(default_factory=dict)
    spreads: dict[tuple[str, ...], specimens.SpecimenSpread] = field(default_factory=dict)

    def differs(self, insertion: Insertion) -> bool:
        """Return whether an insertion goes into a specimen that was not tuned on, and may differ."""
        return self.job.record.specimens == "others" and insertion.specimen not in self._tuned

    def learn_spreads(self, insertions: Sequence[Insertion], jobs: int, pool: TaskPool) -> None:
        """Learn the spreads for some insertions; the specimens are fitted side by side."""
        moving = insertions if specimens.list_groups(self.job.parameters) else ()
        others = {name for insertion in moving for name in self.list_others(insertion)}
        wanted = sorted(others - self.estimates.keys())
        found = dict(run_parts(self._search, wanted, pool, jobs, TaskStop(never_stop)))
        self.estimates |= {specimen: found[n] for n, specimen in enumerate(wanted)}
        for insertion in insertions:
            self.find_spread(insertion)

    def find_spread(self, insertion: Insertion | None) -> specimens.SpecimenSpread:
        """Return the spread between specimens, learned without that of this insertion.

        None stands for one into a specimen that is not in the dataset.
        """
        stated = self.job.recipe.specimens
        prior = (float(np.log(stated.modulus_factor)), float(np.log(stated.bevel_factor)))
        moving = specimens.list_groups(self.job.parameters)
        others = tuple(self.list_others(insertion)) if moving else ()
        if others not in self.spreads:
            self.estimates |= {one: self._search(one) for one in others if one not in self.estimates}
            found = [one for name in others if (one := self.estimates[name]) is not None]
            self.spreads[others] = specimens.learn_spread(found, self.job.parameters, prior)
        return self.spreads[others]

    def move(self, thetas: Floats, insertion: Insertion | None, rng: np.random.Generator) -> Floats:
        """Return draws (B, P) of the parameters in the specimen of an insertion."""
        spread = self.find_spread(insertion)
        return specimens.move_to_new_specimen(self.job.parameters, thetas, spread, len(self._tuned), rng)

    @property
    def _tuned(self) -> set[str]:
        return {one.specimen for one in self.fold.tune}

    def list_others(self, insertion: Insertion | None) -> list[str]:
        """Return the other specimens with as many layer boundaries, by default as those tuned on."""
        counts = {len(one.surfaces) for one in (self.fold.tune if insertion is None else (insertion,))}
        alike = [one for one in self.job.dataset.insertions if len(one.surfaces) in counts]
        deepest = [one for one in alike if max(one.sequence) <= self.job.medium.layers]
        target = set() if insertion is None else {insertion.specimen}
        return sorted({one.specimen for one in deepest} - target)

    def _search(self, specimen: str) -> specimens.SpecimenEstimate | None:
        fits = [one for one in self.job.dataset.insertions if max(one.sequence) <= self.job.medium.layers]
        own = sorted((one for one in fits if one.specimen == specimen), key=lambda one: (one.depth, one.id))
        chosen = np.unique(np.linspace(0, len(own) - 1, MAX_INSERTIONS).round().astype(int))
        everything = self.job.problem(self.fold)
        return specimens.estimate_specimen(
            replace(everything, insertions=tuple(own[k] for k in chosen)), self.theta
        )


def describe_specimen(new: NewSpecimens | None, insertion: Insertion | None, otherwise: str = "same") -> Row:
    """Return what a prediction knows of its specimen; `otherwise` is what it is called without `new`."""
    mu, b, count, treatment = np.nan, np.nan, np.nan, otherwise
    if new is not None:
        spread = new.find_spread(insertion)
        (mu, b), count, treatment = spread.rms.tolist(), float(spread.specimens), "others"
    return {
        "specimen_treatment": treatment,
        "between_sd_ln_mu": mu,
        "between_sd_ln_b": b,
        "other_specimens": count,
    }


def describe_spread(row: Row) -> str:
    """Return in words by how much a specimen differs, from a row of `describe_specimen`."""
    mu, b = (math.exp(row[f"between_sd_ln_{name}"]) for name in ("mu", "b"))
    count = int(row["other_specimens"])
    return (
        f"its moduli differ by a factor of {mu:.2g} and its bevel parameter by {b:.2g} (one standard "
        f"deviation), learned from {count} specimen{'' if count == 1 else 's'} and the prior that the recipe "
        "states"
    )
