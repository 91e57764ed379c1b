"""gaitopt: periodic gaits of legged walkers that slip, after Gamus & Or (2013).

The public names are imported on first use, so that ``import gaitopt`` costs next to nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gaitopt.display import Page
    from gaitopt.errors import GaitoptError
    from gaitopt.gait import Branch, Gait, Status, Trajectory
    from gaitopt.library.answers import explain, prove
    from gaitopt.library.calls import continuation, find, solve
    from gaitopt.library.display import animate, plot, report
    from gaitopt.library.runs import basin, front, multistart, sweep
    from gaitopt.library.stored import load_run
    from gaitopt.mechanics.consistency import check_walker
    from gaitopt.mechanics.cycle import Cycle, ModeSequence
    from gaitopt.mechanics.mechanism import Body, Mechanism
    from gaitopt.mechanics.modes import ImpactLaw, Mode
    from gaitopt.mechanics.walker import Walker
    from gaitopt.problem import Problem, load_problem
    from gaitopt.runs.basin_tiles import Basin
    from gaitopt.runs.front import Front
    from gaitopt.runs.sweep_table import Sweep
    from gaitopt.search.distinct import Gaits
    from gaitopt.study import Verification, Walk, return_map, simulate, verify

__version__ = "0.1.0"

__all__ = [
    "Basin",
    "Body",
    "Branch",
    "Cycle",
    "Front",
    "Gait",
    "GaitoptError",
    "Gaits",
    "ImpactLaw",
    "Mechanism",
    "Mode",
    "ModeSequence",
    "Page",
    "Problem",
    "Status",
    "Sweep",
    "Trajectory",
    "Verification",
    "Walk",
    "Walker",
    "animate",
    "basin",
    "check_walker",
    "continuation",
    "explain",
    "find",
    "front",
    "load_problem",
    "load_run",
    "multistart",
    "plot",
    "prove",
    "report",
    "return_map",
    "simulate",
    "solve",
    "sweep",
    "verify",
]

_HOME = {
    "Basin": "gaitopt.runs.basin_tiles",
    "Body": "gaitopt.mechanics.mechanism",
    "Branch": "gaitopt.gait",
    "Cycle": "gaitopt.mechanics.cycle",
    "Front": "gaitopt.runs.front",
    "Gait": "gaitopt.gait",
    "GaitoptError": "gaitopt.errors",
    "Gaits": "gaitopt.search.distinct",
    "ImpactLaw": "gaitopt.mechanics.modes",
    "Mechanism": "gaitopt.mechanics.mechanism",
    "Mode": "gaitopt.mechanics.modes",
    "ModeSequence": "gaitopt.mechanics.cycle",
    "Page": "gaitopt.display",
    "Problem": "gaitopt.problem",
    "Status": "gaitopt.gait",
    "Sweep": "gaitopt.runs.sweep_table",
    "Trajectory": "gaitopt.gait",
    "Verification": "gaitopt.study",
    "Walk": "gaitopt.study",
    "Walker": "gaitopt.mechanics.walker",
    "animate": "gaitopt.library.display",
    "basin": "gaitopt.library.runs",
    "check_walker": "gaitopt.mechanics.consistency",
    "continuation": "gaitopt.library.calls",
    "explain": "gaitopt.library.answers",
    "find": "gaitopt.library.calls",
    "front": "gaitopt.library.runs",
    "load_problem": "gaitopt.problem",
    "load_run": "gaitopt.library.stored",
    "multistart": "gaitopt.library.runs",
    "plot": "gaitopt.library.display",
    "prove": "gaitopt.library.answers",
    "report": "gaitopt.library.display",
    "return_map": "gaitopt.study",
    "simulate": "gaitopt.study",
    "solve": "gaitopt.library.calls",
    "sweep": "gaitopt.library.runs",
    "verify": "gaitopt.study",
}


def __getattr__(name: str) -> Any:
    """Import a public name from the layer that it lives in (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module 'gaitopt' has no attribute {name!r}; public names: {', '.join(__all__)}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
