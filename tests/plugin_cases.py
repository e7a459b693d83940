"""Install the example plugin, `tests/plugins/needlefit_example`, into a folder for modules."""

import shutil
import sys
from contextlib import contextmanager
from pathlib import Path

from needlefit import plugins

EXAMPLE = "needlefit_example"
VERSION = "1.2.3"


def install(site, *, module=EXAMPLE, entry_point=True, source=None):
    """Put a package into `site`, with the entry point of a plugin or without, as pip would."""
    site.mkdir(parents=True, exist_ok=True)
    if source is None:
        shutil.copytree(Path(__file__).parent / "plugins" / module, site / module)
    else:
        (site / f"{module}.py").write_text(source, encoding="utf-8")
    if entry_point:
        info = site / f"{module}-{VERSION}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: {VERSION}\n")
        (info / "entry_points.txt").write_text(f"[needlefit.plugins]\nexample = {module}\n")
    return site


@contextmanager
def plugin_folder(site, monkeypatch):
    """Let this process find the plugins of a folder, and forget them afterwards."""
    with monkeypatch.context() as patch:
        patch.syspath_prepend(site)
        patch.setenv(plugins.PLUGINS_VARIABLE, "")
        patch.setattr(plugins, "_loaded", None)
        before = set(sys.modules)
        yield
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(site)):
            del sys.modules[name]
