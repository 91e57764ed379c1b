"""The named problems: files shipped with the package, or in a checkout those of its folder ``problems``."""

from importlib.resources import files
from pathlib import Path

from gaitopt.errors import UnknownNameError
from gaitopt.problem.faults import near_miss

SUFFIXES = (".yaml", ".yml")


def problem_names() -> tuple[str, ...]:
    """Every name that ``load_problem`` knows, in alphabetical order."""
    return tuple(sorted(path.stem for path in _folder().glob("*.yaml")))


def find_problem(name_or_path: str | Path, folder: Path | None = None) -> Path:
    """The file of a named problem, or the path itself, taken relative to ``folder``.

    A path is recognised by its suffix or by a separator.

    Raises
    ------
    UnknownNameError
        If it is neither a name nor looks like a path.
    """
    text = str(name_or_path)
    if isinstance(name_or_path, Path) or text.endswith(SUFFIXES) or "/" in text or "\\" in text:
        return (folder or Path()) / name_or_path
    names = problem_names()
    if text not in names:
        raise UnknownNameError(
            f"no problem is called {text!r}{near_miss(text, names)} (or give the path of a .yaml file)"
        )
    return _folder() / f"{text}.yaml"


def _folder() -> Path:
    shipped = Path(str(files("gaitopt.problem"))) / "catalogue"
    return shipped if shipped.is_dir() else Path(__file__).resolve().parents[2] / "problems"
