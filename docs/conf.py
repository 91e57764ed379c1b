"""Sphinx: ``sphinx-build -W docs site``. Equations become MathML, so that the pages need no network.

The build runs the commands of the tutorial, shows what they print and draw, and computes the branch of the start page.
"""

import contextlib
import io
import os
import re
import runpy
import shlex
from collections.abc import Collection
from dataclasses import is_dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from docutils.nodes import (
    Element,
    Node,
    SkipNode,
    Text,
    abbreviation,
    emphasis,
    image,
    literal_block,
    paragraph,
    reference,
)
from latex2mathml.converter import convert

import gaitopt as go
from gaitopt import __version__
from gaitopt.cli.main import main
from gaitopt.show.pages import walks_page

project = "gaitopt"
author = "The gaitopt developers"
release = __version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["examples", "paper"]
nb_execution_mode = "off"  # the notebook is stored with its outputs; a test runs it
myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 3
html_theme = "furo"
html_show_copyright = False
html_title = "gaitopt"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_js_files = [("copy.js", {"defer": "defer"})]
html_math_renderer = "mathml"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False  # what is returned has a name and words; its type stands in the signature
napoleon_attr_annotations = False  # they stand in the signature, in short

CONSTRUCTED = {f"gaitopt.{name}" for name in ("Link", "Mechanism", "Body", "Contact", "Until", "Floor", "Page")}
"""Classes whose instances a reader makes."""
FIELD = re.compile(r"^(\*{0,2}\w+(?:, \w+)*) : (.*)$")


def split_fields(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Put the words of ``a, b : words`` on a line of their own, because napoleon takes them for a type."""
    if what == "property":
        lines[0] = lines[0].replace(": ", " - ")
    split = []
    for line in lines:
        field = FIELD.match(line)  # names without spaces: Sphinx takes what is before a space for a type
        names = field[1].replace(", ", "/" if what == "class" else ",") if field else ""  # napoleon splits only these
        split += [names, f"    {field[2]}"] if field else [line]
    lines[:] = split


def shorten_signature(app: Any, what: str, name: str, obj: Any, options: Any, signature: Any, returned: Any) -> Any:
    """Leave out the signatures of classes whose fields are listed anyway, and which a reader does not construct."""
    named = name not in CONSTRUCTED
    built = what == "class" and signature and ("<factory>" in signature or named)
    return ("", returned) if built and is_dataclass(obj) else None


def shorten_arrays(app: Any, doctree: Any) -> None:
    """Write ``ndarray`` without what numpy has in brackets; shapes stand in the text."""
    for array in list(doctree.findall(lambda node: isinstance(node, Element) and node.astext() == "ndarray")):
        parent, depth = array.parent, 0
        if parent.index(array) + 1 == len(parent) or parent[parent.index(array) + 1].astext() != "[":
            continue
        while True:
            node = parent.pop(parent.index(array) + 1)
            depth += (node.astext() == "[") - (node.astext() == "]")
            if depth == 0:
                break


def visit_inline(writer: Any, node: Any) -> None:
    """Write an equation within a sentence."""
    writer.body.append(convert(node.astext()))
    raise SkipNode


def visit_block(writer: Any, node: Any) -> None:
    """Write an equation on its own."""
    writer.body.append(f"<div>{convert(node.astext(), display='block')}</div>")
    raise SkipNode


def printed(command: str) -> str:
    """What a command of a page prints, on 88 columns."""
    words, _, code = command.partition("  # exit code ")
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        ended = main(shlex.split(words)[1:])
    if ended != int(code or 0):
        raise RuntimeError(f"{command}: exit code {ended}\n{err.getvalue()}")
    return "\n".join(line.rstrip() for line in out.getvalue().strip("\n").splitlines())


LONG = 80
"""Lines of an output above which it scrolls in its block."""


def run_tutorial(app: Any, doctree: Any) -> None:
    """Show below each command and program of the tutorial what it prints, and the figures that a command draws."""
    if app.env.docname != "tutorial":
        return
    pictures = Path(app.srcdir) / "built"  # ignored by git
    pictures.mkdir(exist_ok=True)
    home, columns = Path.cwd(), os.environ.get("COLUMNS")
    blocks = list(doctree.findall(literal_block))
    with TemporaryDirectory() as folder:
        os.chdir(folder)
        os.environ["COLUMNS"] = "88"
        try:
            for block in blocks:
                text = block.astext()
                if block["language"] == "yaml" and (named := re.match(r"name: (\S+)", text)):
                    Path(f"{named[1]}.yaml").write_text(text)
                if block["language"] == "python":
                    Path("program.py").write_text(text)
                    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()):
                        runpy.run_path("program.py")
                    output = out.getvalue().strip()
                    shown = [literal_block(output, output, language="text", classes=["output"])]
                    block.replace_self([block.deepcopy(), *shown])
                if block["language"] == "console":
                    shown = list[Element]()
                    for command in re.findall(r"^\$ (.*)$", text, re.MULTILINE):
                        output = printed(command)
                        shown.append(literal_block(prompt := f"$ {command}", prompt, language="console"))
                        classes = ["output", "long"] if output.count("\n") > LONG else ["output"]
                        shown.append(literal_block(output, output, language="text", classes=classes))
                        for line in output.splitlines():
                            if line.endswith(".svg"):
                                name = Path(line.strip()).name
                                (pictures / name).write_bytes(Path(line.strip()).read_bytes())
                                shown.append(image(uri=f"built/{name}", alt=name, candidates={}))
                    block.replace_self(shown)
        finally:
            os.chdir(home)
            if columns is None:
                del os.environ["COLUMNS"]
            else:
                os.environ["COLUMNS"] = columns


BRIEF = """<style>header, .scroll, .specials, .overview > .scroll, main > section:last-of-type { display: none; }
#gait .charts > :not(.portrait, .forceRatio, .multiplierPlane) { display: none; }
@media (min-width: 40rem) {
  #gait .charts { display: grid; grid-template-columns: repeat(3, 1fr); overflow: visible; }
  #gait :is(.swipe, table.multipliers) { display: none; }
}</style>
</head>"""
"""Style with which the start page shows only diagram, slider, walker and three figures of the page of a branch."""
PUSHES = {"dtheta1": (-0.1, -0.05, -0.02, 0.02, 0.05), "dtheta2": (-0.2, 0.2)}
"""Relative changes of the rates of stance and swing leg just after an impact."""
LEGS = {"dtheta1": "stance leg", "dtheta2": "swing leg"}
PLANE = {"dtheta1": (0.55, 0.8, 15), "dtheta2": (-0.9, 0.3, 15)}
"""Starts of the walks on the page of the basin."""


def draw_start_page(app: Any, failed: Exception | None) -> None:
    """Compute the branch of the start page and write its page, whole and in brief; and the pages of pushed walks."""
    if failed is not None or app.builder.format != "html":
        return
    folder = Path(app.outdir)
    gait = go.solve(go.load_problem("compass-passive-stick"))
    page = folder / "friction.html"
    go.report(go.continuation(gait, "friction", 0.1, progress=False)).save(page)
    brief(page)
    gait = go.solve(go.load_problem("compass-passive-a"))
    go.report(gait).save(folder / "report.html")
    brief(folder / "report.html")
    pushed = {"no push": go.simulate(gait, steps=6)}
    for name, changes in PUSHES.items():
        rate = gait.state[gait.system.state_names.index(name)]
        for change in changes:
            words = f"{LEGS[name]} {abs(change):.0%} {'faster' if change > 0 else 'slower'}"
            pushed[words] = go.simulate(gait, {name: (1 + change) * rate}, steps=6)
    (folder / "push.html").write_text(walks_page(gait, pushed, "Push it just after an impact."))
    brief(folder / "push.html")
    (x, xs), (y, ys) = ((name, np.linspace(*ends)) for name, ends in PLANE.items())
    starts = {f"start at {u:.3g} and {v:.3g} rad/s": {x: u, y: v} for u in xs for v in ys}
    walks = {words: go.simulate(gait, state, steps=6) for words, state in starts.items()}
    (folder / "basin.html").write_text(walks_page(gait, walks, "The basin of attraction of gait A.", (x, y)))
    brief(folder / "basin.html")


def brief(page: Path) -> None:
    """Write the short form of a page beside it."""
    page.with_name(f"{page.stem}-brief.html").write_text(page.read_text().replace("</head>", BRIEF, 1))


MOVED = {
    "why-slip": "index.html#why-slip-matters",
    "citing": "index.html",
    "notebooks": "api.html#in-a-notebook",
    "knees": "zoo.html#knees",
    "round-feet": "zoo.html#round-feet",
    "running": "zoo.html#running",
    "feet": "zoo.html#several-contacts",
    "sensitivity": "branches.html#derivatives",
    "engines": "do-simulators-stick.html#run-a-replay",
    "verification": "troubleshooting.html#the-claims-of-a-verification",
    "scope": "comparison.html#what-gaitopt-can-and-cannot-model",
    "api-problems": "api.html#problems",
    "api-gaits": "api.html#gaits-walks-and-families",
    "api-results": "api.html#results",
    "problem-keys-walker": "problem-keys.html#walkers",
    "problem-keys-control": "problem-keys.html#control-laws",
    "performance": "developer/performance.html",
    "reliability": "developer/reliability.html",
}
"""Present addresses of the contents of former pages."""
REDIRECT = """<!DOCTYPE html><html lang="en"><meta charset="utf-8"><title>Moved</title>
<meta http-equiv="refresh" content="0; url={0}"><p>This page is now at <a href="{0}">{0}</a>.</p></html>
"""


def write_redirects(app: Any, failed: Exception | None) -> None:
    """A page under each former name that leads to the present one."""
    if failed is None and app.builder.format == "html":
        for name, target in MOVED.items():
            (Path(app.outdir) / f"{name}.html").write_text(REDIRECT.format(target))


NAMED = re.compile(r"gait [A-Z]+")
"""A named gait among the terms."""
PLAIN = {
    "walker",
    "mode",
    "phase",
    "step",
    "cycle",
    "gait",
    "family",
    "branch",
    "impact",
    "reset",
    "section",
    "reference",
}
"""Terms that every page uses and that need no tooltip."""


def definitions(source: Path) -> dict[str, str]:
    """The terms of the glossary with their definitions as plain text."""
    text = (source / "glossary.md").read_text(encoding="utf-8")
    found = dict[str, str]()
    for names, words in re.findall(r"^\*\*(.+?)\*\*\n: (.*?)(?=\n\n)", text, re.MULTILINE | re.DOTALL):
        plain = " ".join(re.sub(r"[*`]", "", words).split())
        found |= {name.strip().lower(): plain for name in names.split(",") if name.strip().lower() not in PLAIN}
    for name, motion in re.findall(r"^\| \*\*(\w+)\*\* \| .* \| (.*) \|$", text, re.MULTILINE):
        found[f"gait {name}"] = f"A named gait of Gamus & Or (2013): {motion}"
    return found


def add_tooltips(app: Any, doctree: Any) -> None:
    """Give each term of the glossary its definition as a tooltip where a page uses it first."""
    if app.env.docname in ("glossary", "changelog") or app.env.docname.startswith("api"):
        return
    terms = definitions(Path(app.srcdir))
    for text in list(doctree.findall(Text)):
        if not isinstance(text.parent, (paragraph, emphasis)) or isinstance(
            text.parent.parent, (reference, abbreviation)
        ):
            continue
        rest, pieces = text.astext(), list[Node]()
        while terms and (match := pattern_of(terms).search(rest)) is not None:
            words = terms.pop(match[0] if match[0] in terms else match[1].lower())
            pieces += [Text(rest[: match.start()]), abbreviation(match[0], match[0], explanation=words)]
            rest = rest[match.end() :]
        if pieces:
            text.parent.replace(text, [*pieces, Text(rest)])


def pattern_of(terms: Collection[str]) -> re.Pattern[str]:
    """Any of the terms: a named gait as it is written, another one in either case and with a plural."""
    ordered = sorted(terms, key=len, reverse=True)  # of two terms, one in the other, the longer one
    named = [re.escape(term) for term in ordered if NAMED.fullmatch(term)]
    others = [re.escape(term) for term in ordered if not NAMED.fullmatch(term)]
    either = "|".join(others)
    return re.compile(rf"\b(?:{'|'.join([*named, *([f'(?i:({either})s?)'] if others else [])])})\b")


def setup(app: Any) -> None:
    """Register them."""
    app.connect("doctree-read", add_tooltips)
    app.connect("build-finished", write_redirects)
    app.connect("autodoc-process-docstring", split_fields, priority=1)
    app.connect("autodoc-process-signature", shorten_signature)
    app.connect("doctree-read", shorten_arrays)
    app.connect("doctree-read", run_tutorial, priority=1)
    app.connect("build-finished", draw_start_page)
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
