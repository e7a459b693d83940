"""From a name on the command line to what is shown; one file per kind of name."""

from needlefit.project.subjects import Named, find_subject
from needlefit.viewer.opening.insertion import open_insertion
from needlefit.viewer.opening.run import open_run
from needlefit.viewer.opening.scene import open_scene
from needlefit.viewer.subject import Subject

DEFAULT = "phantom2"
"""The scene that is shown where nothing is named."""


def open_subject(name: str | None, insertion: str | None = None) -> Subject:
    """Return what is shown of SCENE, RUN or DATASET/ID.

    Parameters
    ----------
    name : str or None
        None: the scene `DEFAULT`.
    insertion : str, optional
        Of the run or dataset; by default what `name` says, else the first.

    Raises
    ------
    ConfigError, DataError
        If there is no such thing, or it has a fault.
    """
    named = find_subject(DEFAULT if name is None else name)
    if insertion is not None and named.kind != "scene":
        named = Named(named.kind, named.name, named.path, insertion)
    return _OPENERS[named.kind](named)


_OPENERS = {"scene": open_scene, "run": open_run, "dataset": open_insertion}
