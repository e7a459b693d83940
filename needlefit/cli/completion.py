"""Shell completion of names."""

from needlefit.project.locate import STUDY_GROUPS, list_names, list_runs


def complete_scenes(incomplete: str) -> list[str]:
    """Return the scenes whose names begin so."""
    return _with_prefix(list_names("scene"), incomplete)


def complete_studies(incomplete: str) -> list[str]:
    """Return the studies whose names begin so, and the names of several."""
    return _with_prefix([*list_names("study"), *STUDY_GROUPS], incomplete)


def complete_targets(incomplete: str) -> list[str]:
    """Return the studies and fits whose names begin so."""
    return _with_prefix([*list_names("study"), *list_names("fit")], incomplete)


def complete_runs(incomplete: str) -> list[str]:
    """Return the runs in reports/ whose names begin so."""
    return [name for name in list_runs() if name.startswith(incomplete)]


def complete_datasets(incomplete: str) -> list[str]:
    """Return the datasets whose names begin so."""
    return _with_prefix(list_names("dataset"), incomplete)


def complete_scans(incomplete: str) -> list[str]:
    """Return the tables of scans whose names begin so."""
    return _with_prefix(list_names("scans"), incomplete)


def complete_reconstructions(incomplete: str) -> list[str]:
    """Return the recipes of reconstruction whose names begin so."""
    return _with_prefix(list_names("reconstruction"), incomplete)


def complete_view_targets(incomplete: str) -> list[str]:
    """Return the scenes, runs and datasets whose names begin so."""
    return _with_prefix([*list_names("scene"), *list_runs(), *list_names("dataset")], incomplete)


def _with_prefix(known: list[str], incomplete: str) -> list[str]:
    return [name for name in known if name.startswith(incomplete)]
