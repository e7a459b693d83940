"""What docstrings hold in single backquotes: code, and a link where it names something of needlefit.

A name that begins with a package (`mechanics.simulate`) must exist, or the build fails.
Any other may be a parameter, a file or a key, and stays code where its module holds nothing of that name.
"""

from api_pages import PACKAGES
from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.docutils import SphinxRole
from sphinx.util.nodes import make_refnode

ENDINGS = {"toml", "csv", "json", "pdf", "gz", "bib"}


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the role, and what becomes of names that nothing answers to."""
    app.add_role("name", Name())
    app.connect("missing-reference", _perhaps)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


class Name(SphinxRole):
    """The role that single backquotes have."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        """Return the name as code, within a reference if it can be one."""
        code = nodes.literal(self.rawtext, self.text)
        parts = self.text.split(".")
        if parts[-1] in ENDINGS or not all(part.isidentifier() for part in parts):
            return [code], []
        firm = len(parts) > 1 and parts[0] in PACKAGES
        reference = addnodes.pending_xref(
            "",
            code,
            refdomain="py",
            reftype="obj" if firm else "perhaps",
            reftarget=f"needlefit.{self.text}" if firm else self.text,
            refdoc=self.env.docname,
        )
        reference["py:module"] = self.env.ref_context.get("py:module")
        reference["py:class"] = self.env.ref_context.get("py:class")
        return [reference], []


def _perhaps(
    app: Sphinx, env: BuildEnvironment, node: addnodes.pending_xref, code: nodes.Element
) -> nodes.Node | None:
    """Return what a soft name stands for: the one thing that a dotted name ends, else the code that it is."""
    if node["reftype"] != "perhaps":
        return None
    target = node["reftarget"]
    known = env.domains.python_domain.objects
    matches = [name for name in known if name.endswith(f".{target}")] if "." in target else []
    if len(matches) != 1:
        return code
    there = known[matches[0]]
    return make_refnode(app.builder, node["refdoc"], there.docname, there.node_id, code, matches[0])
