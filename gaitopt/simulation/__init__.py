"""The forward hybrid simulator, which chooses the modes by itself."""

from gaitopt.simulation.engine import Engine, choose_engine, make_stepper
from gaitopt.simulation.scipy_stepper import ScipyStepper
from gaitopt.simulation.simulator import Simulator, StepOutcome
from gaitopt.simulation.stepper import Arrival, BatchStepper, Stepper

__all__ = [
    "Arrival",
    "BatchStepper",
    "Engine",
    "ScipyStepper",
    "Simulator",
    "StepOutcome",
    "Stepper",
    "choose_engine",
    "make_stepper",
]
