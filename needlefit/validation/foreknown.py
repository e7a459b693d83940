"""What is known of the parameters when a needle is planned: a sampled posterior, or a fit made now."""

from pathlib import Path

from needlefit.errors import ConfigError
from needlefit.inference.draws import Draws, from_posterior
from needlefit.inference.optimize import minimize
from needlefit.inference.sampling.posterior import load
from needlefit.inference.starts import Watch
from needlefit.inference.weighing.about_fit import by_importance
from needlefit.project.plain import plain
from needlefit.project.reading import is_file, stored_values
from needlefit.project.run_file import read_run
from needlefit.project.streams import stream
from needlefit.project.threads import one_thread
from needlefit.validation.job import Job, Settings
from needlefit.validation.provenance import work
from needlefit.validation.stored import posterior_names

DRAWS = 400
"""Of the parameters, of which a planned needle is foretold."""

(POSTERIOR,) = posterior_names(1)


@one_thread
def foreknown(job: Job, run: Path, settings: Settings, required: bool = False) -> Draws | None:
    """Return draws of the posterior in the folder `run`, or, where none was sampled, about a fit made now.

    Returns
    -------
    Draws or None
        None where the search was interrupted.

    Raises
    ------
    ConfigError
        If the posterior is of other data or another configuration, or there is none though it is required.
    """
    if is_file(run / POSTERIOR):
        require_same(job, run)
        with stored_values(run / POSTERIOR):
            return from_posterior(load(run / POSTERIOR), job.parameters, DRAWS)
    if required:
        raise ConfigError(
            f"holds no {POSTERIOR}",
            where=str(run),
            expected="the folder of a run of one fold that was sampled",
            mend="sample it (`needlefit tune TARGET --sample`), or leave --run out",
        )
    (fold,) = job.folds
    problem = job.problem(fold)
    rng = stream(job.recipe.seed, job.name, fold.name, "fitted", "starts")
    fit = minimize(problem, job.recipe, rng, Watch(stop=settings.stop, jobs=settings.jobs))
    if fit.interrupted:
        return None
    found = by_importance(problem, fit, DRAWS, stream(job.recipe.seed, job.name, "predict"), settings.jobs)
    faults = (*((fit.fault,) if fit.fault else ()), *found.faults)
    return Draws(found.thetas, found.source, faults)


def require_same(job: Job, run: Path) -> None:
    """Raise ConfigError if the run in a folder is of other data or another configuration than `job`."""
    said, ours = read_run(run), work(job)
    pairs = {key: (said.get(key), ours[key]) for key in ("dataset", "medium", "folds")}
    recipe = said.get("recipe")
    theirs = recipe.get("likelihood") if isinstance(recipe, dict) else None
    pairs["likelihood"] = (theirs, job.recipe.likelihood.model_dump(mode="json"))
    for key, (found, wanted) in pairs.items():
        if found != plain(wanted):
            raise ConfigError(
                f"its posterior is of another {key}",
                where=str(run),
                expected=f"the {key} that {job.name} names now",
                mend="sample again (`needlefit tune TARGET --sample`), or name the right one with --run",
            )
