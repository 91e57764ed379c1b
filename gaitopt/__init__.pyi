"""The public names, stated once: type checkers read them here, ``__init__.py`` imports each on first use."""

from gaitopt.display import Page as Page
from gaitopt.errors import GaitoptError as GaitoptError
from gaitopt.gait import Branch as Branch
from gaitopt.gait import Gait as Gait
from gaitopt.gait import Status as Status
from gaitopt.gait import Trajectory as Trajectory
from gaitopt.library.answers import explain as explain
from gaitopt.library.answers import prove as prove
from gaitopt.library.calls import continuation as continuation
from gaitopt.library.calls import find as find
from gaitopt.library.calls import solve as solve
from gaitopt.library.display import animate as animate
from gaitopt.library.display import plot as plot
from gaitopt.library.display import report as report
from gaitopt.library.runs import basin as basin
from gaitopt.library.runs import front as front
from gaitopt.library.runs import multistart as multistart
from gaitopt.library.runs import sweep as sweep
from gaitopt.library.stored import load_run as load_run
from gaitopt.mechanics.consistency import check_walker as check_walker
from gaitopt.mechanics.cycle import Cycle as Cycle
from gaitopt.mechanics.cycle import ModeSequence as ModeSequence
from gaitopt.mechanics.mechanism import Body as Body
from gaitopt.mechanics.mechanism import Mechanism as Mechanism
from gaitopt.mechanics.modes import ImpactLaw as ImpactLaw
from gaitopt.mechanics.modes import Mode as Mode
from gaitopt.mechanics.walker import Walker as Walker
from gaitopt.problem import Problem as Problem
from gaitopt.problem import load_problem as load_problem
from gaitopt.runs.basin_tiles import Basin as Basin
from gaitopt.runs.front import Front as Front
from gaitopt.runs.sweep_table import Sweep as Sweep
from gaitopt.search.distinct import Gaits as Gaits
from gaitopt.study import Verification as Verification
from gaitopt.study import Walk as Walk
from gaitopt.study import return_map as return_map
from gaitopt.study import simulate as simulate
from gaitopt.study import verify as verify

__version__: str
