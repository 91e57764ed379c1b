"""The forward hybrid simulator, which chooses the modes by itself."""

from gaitopt.simulation.engine import Engine as Engine
from gaitopt.simulation.engine import choose_engine as choose_engine
from gaitopt.simulation.engine import make_stepper as make_stepper
from gaitopt.simulation.scipy_stepper import ScipyStepper as ScipyStepper
from gaitopt.simulation.simulator import Simulator as Simulator
from gaitopt.simulation.simulator import StepOutcome as StepOutcome
from gaitopt.simulation.stepper import Arrival as Arrival
from gaitopt.simulation.stepper import BatchStepper as BatchStepper
from gaitopt.simulation.stepper import Stepper as Stepper
