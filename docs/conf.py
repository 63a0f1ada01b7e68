"""The site made of these pages: `sphinx-build -W --keep-going -n -b html docs build/site`."""

import os
import re
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.ext import napoleon

from async_tnt import __version__

project = "async_tnt"
author = "the async_tnt authors"
release = __version__
html_theme = "furo"
html_title = f"async_tnt {release}"
extensions = ["myst_nb", "sphinx.ext.autodoc"]
nb_execution_mode = "off"  # notebooks are kept with their output, and run by the tests

# Pages: what GitHub renders from the same files.
myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]

# Docstrings, see `to_restructured_text`.
default_role = "code"
STYLE = napoleon.Config(
    napoleon_use_param=False,
    napoleon_attr_annotations=False,
    napoleon_custom_sections=["Returns", "Yields"],
)
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
maximum_signature_line_length = 100
# Types of other packages and internal ones are not documented here: only public names have to
# exist.
PACKAGES = "sources|networks|training|simulation|views"
nitpick_ignore_regex = [("py:.*", rf"(?!(async_tnt(\.({PACKAGES}))?|tnt_reference)\.\w+$).*")]

DOCS = Path(__file__).parent
ROOT = DOCS.parent
# files outside of `docs` -> the pages of the site that show them
OUTSIDE = {
    ROOT / "README.md": "project/readme",
    ROOT / "ARCHITECTURE.md": "project/architecture",
    ROOT / "CONTRIBUTING.md": "project/contributing",
    ROOT / "CHANGELOG.md": "project/changelog",
    ROOT / "experiments" / "README.md": "project/experiments",
    ROOT / "experiments" / "RESULTS.md": "project/all_results",
}


def read_outside(app: Sphinx, name: str, source: list[str]) -> None:
    """Put the text of a file of `OUTSIDE` on its page, and let links lead to the pages of the files
    that they name."""
    page = DOCS / f"{name}.md"
    shown = page
    for file, place in OUTSIDE.items():
        if place == name:
            shown = file
            source[0] = file.read_text(encoding="utf-8")
            app.env.note_dependency(str(file))

    def in_site(link: re.Match[str]) -> str:
        file = (shown.parent / link[1]).resolve()
        if file in OUTSIDE:
            file = DOCS / f"{OUTSIDE[file]}.md"
        return f"]({os.path.relpath(file, page.parent)}{link[2] or ''})"

    source[0] = re.sub(r"\]\((?!https?:)([^)#]+)(#[^)]*)?\)", lambda link: in_site(link), source[0])


def to_restructured_text(
    app: Sphinx, what: str, name: str, value: object, options: object, lines: list[str]
) -> None:
    """Translate a docstring of this project, by way of napoleon.

    Only the first paragraph of a module's docstring is kept. An indented block is a formula or
    code. In a section, `name : text` is a name and its text; napoleon would take the text for a
    type, which is in the signature.
    """
    # without a docstring of its own, a value has that of its type
    if what == "data" and lines[:1] == (value.__doc__ or "").splitlines()[:1]:
        lines.clear()
    if what == "module":
        del lines[lines.index("") :]
    text = [""]
    in_section = False
    for line in lines:
        in_section = in_section or bool(re.fullmatch("-{4,}", line))
        entry = re.fullmatch(r"(\*{0,2}\w[\w, .*]*) : (.*)", line)
        if in_section and entry:
            text += [entry[1], f"    {entry[2]}"]
            continue
        if not in_section and line.startswith("    ") and text[-1] == "" and not indented(text):
            text += ["::", ""]
        text.append(line)
    # napoleon takes what precedes a colon for the type of an attribute, but not of a method
    if what in ("attribute", "property"):
        what = "method"
    lines[:] = napoleon.NumpyDocstring(text[1:], STYLE, app, what, name, value, options).lines()


def indented(text: list[str]) -> bool:
    """Whether the last line that is not empty is indented."""
    filled = [line for line in text if line]
    return bool(filled) and filled[-1].startswith("    ")


def without_factory(
    app: Sphinx, what: str, name: str, value: object, options: object, arguments: str, returns: str
):
    """A signature that Sphinx can parse: dataclasses write `<factory>` for a default that is made
    by a function."""
    return arguments and arguments.replace("<factory>", "..."), returns


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", read_outside)
    app.connect("autodoc-process-docstring", to_restructured_text)
    app.connect("autodoc-process-signature", without_factory)
