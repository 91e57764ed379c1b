"""The common style of all figures: labels and units of quantities, colours, line styles, panels, legends and files.

The colours for the colour-blind are those of Okabe and Ito (2008), https://jfly.uni-koeln.de/color/. A foot that slips
is dashed. Figures are built without pyplot, which would need a window system and global state.
"""

import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from io import BytesIO
from math import degrees
from pathlib import Path
from textwrap import fill
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gaitopt.model.modes import Mode
from gaitopt.model.units import MOTOR_WORDS
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import FRICTION_LABELS, SCALARS, Driven, label_of, unit_of
from gaitopt.problem.source import parse_source
from gaitopt.store.files import write_whole

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
CURVES = (*COLOURS, "#332288", "#999933", "#882255", "#44aa99", "#cc6677", "#117733", "#aa4499")
"""Colours of curves in a figure that may have many. Those after ``COLOURS`` are from P. Tol's muted scheme,
https://personal.sron.nl/~pault/."""
MODE_COLOURS = {
    Mode.STICK: "#4d4d4d", Mode.SLIP_FORWARD: "#e69f00", Mode.SLIP_BACKWARD: "#56b4e9", Mode.FLIGHT: "#9bd1b3",
}  # fmt: skip
MODE_NAMES = {mode: mode.replace("_", " ") for mode in MODE_COLOURS}
NEUTRAL = "#757575"
"""Colour of legend entries that stand for all curves; it is visible on white and on black."""
SLIP_DASHES, FLIGHT_DOTS = (0, (3.5, 1.8)), (0, (1, 1.6))
JUMP: dict[str, Any] = {"linestyle": ":", "linewidth": 0.8}
"""Line of a jump at the impact."""

LEGEND_CHARACTERS, LEGEND_LINE = 96, 9
"""Number of characters that fit side by side under a figure, and width of a sample line with its gap in characters."""
LEGEND_ROWS, LEGEND_ROW = 3, 0.2
"""Number of rows of a legend that fit below a figure, and height of each further row [inch]."""
WIDTH, HEIGHT = 6.0, 4.0
"""Size of a figure with one panel [inch]."""
STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 10,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": "medium",
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": "small",
    "figure.constrained_layout.use": True,
    "savefig.dpi": 160,
    "svg.fonttype": "path",
    "svg.hashsalt": "gaitopt",
    "pdf.fonttype": 42,
}
SYMBOLS = {"spectral_radius": "|λ|", "friction": "μ"}
GREEK = {"theta": "θ", "phi": "φ", "psi": "ψ", "alpha": "α"}
SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_STYLING = threading.RLock()
"""The lock that a thread holds while Matplotlib has the settings of ``STYLE``, because they affect the whole
process."""
_AXES: ContextVar[tuple[Axes, ...] | None] = ContextVar("axes", default=None)
"""The axes into which figures are drawn; None if figures have axes of their own."""
_NO_DATE: dict[str, dict[str, Any]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {}}
STILL = tuple(_NO_DATE)
"""Formats of a figure."""


@contextmanager
def figure_style() -> Iterator[None]:
    """A context manager with gaitopt's settings of Matplotlib, for one thread at a time.

    Settings of the user's style sheet take precedence, and the user's own axes are not changed.
    """
    with _STYLING:
        ours = {k: v for k, v in STYLE.items() if mpl.rcParams[k] == mpl.rcParamsDefault[k] and _AXES.get() is None}
        with mpl.rc_context(ours):
            yield


@contextmanager
def drawing_into(axes: Axes | Sequence[Axes] | None) -> Iterator[None]:
    """Draw the next figure into given axes rather than a figure of its own, within the block."""
    given: tuple[Any, ...] | None = None if axes is None else tuple(np.array(axes, dtype=object).flat)
    if given is not None and not all(isinstance(one, Axes) for one in given):
        raise TypeError(f"ax is {axes!r}, but must be Matplotlib axes, as plt.subplots()[1]")
    token = _AXES.set(given)
    try:
        yield
    finally:
        _AXES.reset(token)


def panels(
    rows: int = 1, *, heights: Sequence[float] | None = None, height: float = HEIGHT
) -> tuple[Figure, list[Axes]]:
    """A figure with panels one above the other that share their horizontal axis; or the axes of ``drawing_into``.

    Raises
    ------
    ValueError
        If ``drawing_into`` was given another number of axes.
    """
    given = given_axes(rows)
    if given is not None:
        return given
    with figure_style():
        figure = Figure(figsize=(WIDTH, height))
        FigureCanvasAgg(figure)
        ratios = list(heights) if heights else [1.0] * rows
        axes = figure.subplots(rows, 1, sharex=True, squeeze=False, height_ratios=ratios)
    return figure, list(axes[:, 0])


def given_axes(count: int) -> tuple[Figure, list[Axes]] | None:
    """The axes of ``drawing_into`` and their figure; None if the figure has axes of its own.

    Raises
    ------
    ValueError
        If there are not ``count`` axes.
    """
    given = _AXES.get()
    if given is None:
        return None
    if len(given) != count:
        remedy = "ax=axes" if count == 1 else f"ax=plt.subplots({count}, 1, sharex=True)[1]"
        raise ValueError(f"this figure has {count} panel{'s' * (count > 1)}, not {len(given)}: give {remedy}")
    figure = given[0].get_figure(root=True)
    assert figure is not None, "axes that were removed from their figure"
    return figure, list(given)


def save(figure: Figure, stem: Path, formats: Sequence[str] = ("svg", "png")) -> list[Path]:
    """Write a figure in several formats; the same figure gives the same bytes."""
    paths = [stem.with_name(f"{stem.name}.{extension}") for extension in formats]
    for path, extension in zip(paths, formats, strict=True):
        write_whole(path, encoded(figure, extension))
    return paths


def encoded(figure: Figure, extension: str, dpi: float = STYLE["savefig.dpi"]) -> bytes:
    """The bytes of a figure as a file."""
    content = BytesIO()
    with figure_style():
        figure.savefig(content, format=extension, metadata=_NO_DATE[extension], dpi=dpi)
    return content.getvalue()


def dashes(mode: Mode) -> Any:
    """Line style of a mode: solid if a foot sticks, dashed if feet only slip, dotted in flight."""
    sticks = any(mode.contacts[name] == Mode.STICK for name in mode.touching)
    return "-" if sticks else SLIP_DASHES if mode.touching else FLIGHT_DOTS


def entry(text: str, **style: Any) -> Line2D:
    """A legend's entry."""
    return Line2D([], [], label=text, **({"color": NEUTRAL} | style))


def mode_legend(modes: Sequence[Mode], *, each: bool = False) -> list[Line2D]:
    """Legend entries for the line styles of some modes; ``each``: every contact has its own curve."""
    if each:
        states = {mode.contacts[name] for mode in modes for name in mode.touching}
        styles: list[Any] = ["-"] * (Mode.STICK in states) + [SLIP_DASHES] * bool(states - {Mode.STICK})
        styles += [FLIGHT_DOTS] * any(not mode.touching for mode in modes)
    else:
        styles = [dashes(mode) for mode in modes]
    many_feet = not each and any(len(mode.touching) > 1 for mode in modes)
    texts = ("a foot sticks", "all feet on the ground slip") if many_feet else ("foot sticks", "foot slips")
    known = zip(("-", SLIP_DASHES, FLIGHT_DOTS), (*texts, "flight"), strict=True)
    return [entry(text, linestyle=style) for style, text in known if style in styles]


def legend_below(figure: Figure, handles: Sequence[Any]) -> None:
    """Add a legend under the axes, in as many columns as fit; long entries are wrapped, and the figure gets taller."""
    given = _AXES.get()
    if given is not None:
        given[-1].legend(handles=list(handles), fontsize="small")
        return
    for handle in handles:
        handle.set_label(fill(str(handle.get_label()), LEGEND_CHARACTERS - LEGEND_LINE))
    lines = [str(handle.get_label()).split("\n") for handle in handles]
    longest = max(len(line) for own in lines for line in own)
    columns = max(1, min(len(handles), LEGEND_CHARACTERS // (longest + LEGEND_LINE)))
    rows = -(-sum(map(len, lines)) // columns)
    figure.set_figheight(figure.get_figheight() + LEGEND_ROW * max(0, rows - LEGEND_ROWS))
    with figure_style():
        figure.legend(handles=list(handles), loc="outside lower center", ncols=columns)


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """Name and unit of a quantity."""

    name: str
    unit: str = ""

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """The parameter of a branch, which is shown in degrees if the problem file states it in degrees."""

    key: str
    in_degrees: bool = False
    problem: Problem | None = None

    @property
    def label(self) -> Label:
        """The label with the unit in which the parameter is shown."""
        written = label(self.key, self.problem)
        return replace(written, unit="°") if self.in_degrees else written

    def shown(self, records: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
        """Points and special points with their ``value`` in this unit."""
        if not self.in_degrees:
            return list(records)
        return [{**r, "value": degrees(r["value"])} if r.get("value") is not None else r for r in records]


def parameter_of(problem: Problem, key: str) -> Parameter:
    """The continued parameter of a problem, with the unit of the problem file."""
    value: Any = parse_source(problem.text, problem.name).data if problem.text else None
    for name in key.split("."):
        value = value.get(name) if isinstance(value, Mapping) else None
    in_degrees = isinstance(value, str) and value.rstrip().endswith("deg")
    return Parameter(key=key, in_degrees=in_degrees, problem=problem)


def symbol(state: str) -> str:
    """The symbol of a state: θ̇₁ for ``dtheta1``, and ``stance shin`` for ``stance_shin``."""
    rate = state.startswith("d") and len(state) > 1
    name = state[1:] if rate else state
    stem = name.rstrip("0123456789")
    greek = GREEK.get(stem, stem)
    written = greek.replace("_", " ") + name[len(stem) :].translate(SUBSCRIPTS)
    if not rate:
        return written
    return written[0] + "\u0307" + written[1:] if len(greek) == 1 else f"rate of {written}"


def label(key: str, of: Driven | None = None) -> Label:
    """Label of a scalar, a state or a parameter of a problem or system; an unknown key is its own label."""
    if key in SCALARS or key in FRICTION_LABELS or key.startswith("friction."):
        return Label(name=f"{label_of(key, of)} {SYMBOLS.get(key, '')}".rstrip(), unit=typeset(unit_of(key, of)))
    last, unit = key.rpartition(".")[2], unit_of(key, of)
    return Label(name=f"{last.replace('_', ' ')} {MOTOR_WORDS.get(unit, '')}".rstrip(), unit=typeset(unit))


def typeset(unit: str) -> str:
    """A unit with exponents as superscripts."""
    return unit.replace("^2", "²")
