"""What results show of themselves: tables, pictures and pages, made by a layer above that is named here as text.

As with the plotting backend of pandas, the name is data, so that no result has to import figures, pages or files.
"""

from dataclasses import dataclass
from html import escape
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes


BACKEND = "gaitopt.api.pictures"
"""The module whose functions ``plot``, ``animate``, ``report``, ``save`` and ``html`` do the work."""


FRAME_HEIGHT = 620
"""Height of a page inside a notebook [pixels]."""


@dataclass(frozen=True, slots=True)
class Page:
    """One HTML page that needs no network: shown inside a notebook, or written to a file."""

    title: str
    text: str

    def __repr__(self) -> str:
        return f"<Page {self.title}: {len(self.text.encode()) / 1000:.0f} kB; .save(path) writes it>"

    def _repr_html_(self) -> str:
        style = f"width: 100%; height: {FRAME_HEIGHT}px; border: 0"
        return f'<iframe srcdoc="{escape(self.text)}" title="{escape(self.title)}" style="{style}"></iframe>'

    def save(self, path: str | Path) -> Path:
        """Write the page; the file appears whole or not at all."""
        return Path(_call("write_page", self.text, Path(path)))


class Tabulated:
    """A result with a table for a notebook."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return str(_call("html", self))


class Plotted(Tabulated):
    """A result with figures."""

    __slots__ = ()

    def plot(self, what: str | None = None) -> "Axes":
        """Draw one figure, and show it in a notebook; see ``gaitopt.plot``."""
        return _call("plot", self, what)


class Reported(Plotted):
    """A result with figures and a page of its own."""

    __slots__ = ()

    def report(self) -> Page:
        """Everything about it as one offline HTML page; see ``gaitopt.report``."""
        return _call("report", self)


class Moving(Reported):
    """A motion: its walker moves on a page, and it is stored in a run folder."""

    __slots__ = ()

    def animate(self) -> Page:
        """The moving walker as an offline page, shown in a notebook; see ``gaitopt.animate``."""
        return _call("animate", self)

    def save(self, path: str | Path | None = None) -> Path:
        """Store it in a run folder, by default ``results/NAME-HASH``; ``gaitopt.load_run`` reads it back."""
        return _call("save", self, path)


def _call(name: str, *arguments: Any) -> Any:
    return getattr(import_module(BACKEND), name)(*arguments)
