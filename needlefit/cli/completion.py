"""The names that the shell completes."""

from needlefit.project.places import GROUPS, names, run_names


def scenes(incomplete: str) -> list[str]:
    """Return the scenes whose names begin so."""
    return _beginning(names("scene"), incomplete)


def studies(incomplete: str) -> list[str]:
    """Return the studies whose names begin so, and the names of several."""
    return _beginning([*names("study"), *GROUPS], incomplete)


def targets(incomplete: str) -> list[str]:
    """Return the studies and fits whose names begin so."""
    return _beginning([*names("study"), *names("fit")], incomplete)


def runs(incomplete: str) -> list[str]:
    """Return the runs in reports/ whose names begin so."""
    return [name for name in run_names() if name.startswith(incomplete)]


def datasets(incomplete: str) -> list[str]:
    """Return the datasets whose names begin so."""
    return _beginning(names("dataset"), incomplete)


def scans(incomplete: str) -> list[str]:
    """Return the tables of scans whose names begin so."""
    return _beginning(names("scans"), incomplete)


def reconstructions(incomplete: str) -> list[str]:
    """Return the recipes of reconstruction whose names begin so."""
    return _beginning(names("reconstruction"), incomplete)


def subjects(incomplete: str) -> list[str]:
    """Return the scenes, runs and datasets whose names begin so."""
    return _beginning([*names("scene"), *run_names(), *names("dataset")], incomplete)


def _beginning(known: list[str], incomplete: str) -> list[str]:
    return [name for name in known if name.startswith(incomplete)]
