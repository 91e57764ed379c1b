"""The public names, stated once: type checkers read them here, ``__init__.py`` imports each on first use."""

from gaitopt.api.pictures import animate as animate
from gaitopt.api.pictures import plot as plot
from gaitopt.api.pictures import report as report
from gaitopt.api.pictures import save_figures as save_figures
from gaitopt.api.stored import load_run as load_run
from gaitopt.api.verbs import basin as basin
from gaitopt.api.verbs import check_proof as check_proof
from gaitopt.api.verbs import continuation as continuation
from gaitopt.api.verbs import explain as explain
from gaitopt.api.verbs import find as find
from gaitopt.api.verbs import front as front
from gaitopt.api.verbs import multistart as multistart
from gaitopt.api.verbs import neighbourhood as neighbourhood
from gaitopt.api.verbs import prove as prove
from gaitopt.api.verbs import simulate as simulate
from gaitopt.api.verbs import solve as solve
from gaitopt.api.verbs import sweep as sweep
from gaitopt.api.verbs import verify as verify
from gaitopt.display import Page as Page
from gaitopt.errors import GaitoptError as GaitoptError
from gaitopt.gait.branch import Branch as Branch
from gaitopt.gait.gait import Gait as Gait
from gaitopt.gait.gait import Status as Status
from gaitopt.gait.trajectory import Trajectory as Trajectory
from gaitopt.model.checks import check_walker as check_walker
from gaitopt.model.cycle import Cycle as Cycle
from gaitopt.model.cycle import ModeSequence as ModeSequence
from gaitopt.model.friction import ImpactLaw as ImpactLaw
from gaitopt.model.modes import Mode as Mode
from gaitopt.model.walker import Body as Body
from gaitopt.model.walker import Mechanism as Mechanism
from gaitopt.model.walker import Walker as Walker
from gaitopt.nlp.following import Family as Family
from gaitopt.problem.problem import Problem as Problem
from gaitopt.problem.problem import load_problem as load_problem
from gaitopt.problem.problem import parse_problem as parse_problem
from gaitopt.problem.source import problem_names as problem_names
from gaitopt.runs.basin import Basin as Basin
from gaitopt.runs.front import Front as Front
from gaitopt.runs.sweep import Sweep as Sweep
from gaitopt.search.find import Gaits as Gaits
from gaitopt.verification.step_map import return_map as return_map
from gaitopt.verification.verify import Verification as Verification
from gaitopt.verification.walk import Walk as Walk

__version__: str
