"""The methods ``plot``, ``animate``, ``report`` and ``save`` of results, and their tables in notebooks.

A layer above does the work. Its name is a text, like that of the plotting backend of pandas, so that no result imports
figures, pages or files.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes


BACKEND = "gaitopt.api.pictures"
"""The module with the functions ``plot``, ``animate``, ``report``, ``save`` and ``html``."""


ALL_DIGITS = 17
"""Number of digits that distinguish any two doubles."""
FRAME_HEIGHT = 620
"""Height of a page inside a notebook [pixels]."""


def counted(n: int, noun: str, plural: str = "") -> str:
    """A number with a noun in singular or plural, such as "1 gait" or "2 gaits"; the plural has an s by default."""
    return f"{n} {noun if n == 1 else plural or f'{noun}s'}"


def distinguished(first: float, second: float, digits: int = 4) -> tuple[str, str]:
    """The texts of two numbers with at least ``digits`` digits, and with enough digits to show which one is larger."""
    texts = (f"{first:.{digits}g}", f"{second:.{digits}g}")
    return (
        texts
        if digits >= ALL_DIGITS or first == second or texts[0] != texts[1]
        else distinguished(first, second, digits + 1)
    )


@dataclass(frozen=True, slots=True)
class Page:
    """One offline HTML page: a notebook shows it, ``save`` writes it to a file.

    Attributes
    ----------
    title, text : title and HTML of the page.
    movie : for an animation, the function that returns the file in a format, ``gif`` or ``mp4``; None for other pages.
    """

    title: str
    text: str
    movie: Callable[[str], bytes] | None = field(default=None, compare=False, repr=False)

    def __repr__(self) -> str:
        return f"<Page {self.title}: {len(self.text.encode()) / 1000:.0f} kB; .save(path) writes it>"

    def _repr_html_(self) -> str:
        style = f"width: 100%; height: {FRAME_HEIGHT}px; border: 0"
        return f'<iframe srcdoc="{escape(self.text)}" title="{escape(self.title)}" style="{style}"></iframe>'

    def save(self, path: str | Path) -> Path:
        """Write the page; the file appears whole or not at all.

        Parameters
        ----------
        path : a path that ends in ``.html``; for an animation also ``.gif`` or, if ffmpeg is installed, ``.mp4``.

        Raises
        ------
        UnknownNameError
            If the path has another suffix, or ffmpeg is missing.
        StorageError
            If the file cannot be written.
        """
        return Path(_call("write_page", self, Path(path)))


class Tabulated:
    """A result with a table for a notebook."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return str(_call("html", self))


class Plotted(Tabulated):
    """A result with figures."""

    __slots__ = ()

    def plot(self, what: str | None = None, *, ax: "Axes | Sequence[Axes] | None" = None) -> "Axes":
        """Draw one figure, into ``ax`` if it is given; see ``gaitopt.plot``."""
        return _call("plot", self, what, ax=ax)


class Reported(Plotted):
    """A result with figures and a report."""

    __slots__ = ()

    def report(self) -> Page:
        """The result as one offline HTML page; see ``gaitopt.report``."""
        return _call("report", self)


class Moving(Reported):
    """A motion, with an animation and a run folder."""

    __slots__ = ()

    def animate(self) -> Page:
        """The moving walker as an offline page; see ``gaitopt.animate``."""
        return _call("animate", self)

    def save(self, path: str | Path | None = None) -> Path:
        """Store the result in a run folder, by default ``results/NAME-HASH``; ``gaitopt.load_run`` reads it back."""
        return _call("save", self, path)


def _call(name: str, *arguments: Any, **named: Any) -> Any:
    return getattr(import_module(BACKEND), name)(*arguments, **named)


def spelled(name: str) -> str:
    """The name of a type or status in JSON as text: ``fold Neimark-Sacker``, ``resonance 1:3``."""
    return re.sub(r"(\d) (\d)", r"\1:\2", name.replace("_", " ").replace("neimark sacker", "Neimark-Sacker"))
