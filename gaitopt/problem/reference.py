"""The other problem whose gait a control tracks or its curve starts from: its name in the file, and what it must be."""

from collections.abc import Iterator

from gaitopt.mechanics.walker import Walker
from gaitopt.problem.control_sections import ControlSpec, CurveReference, PDSpec
from gaitopt.problem.faults import Key, shown
from gaitopt.problem.statement import ProblemStatement


def reference_name(control: ControlSpec | None) -> tuple[str, Key]:
    """Name or path of the other problem in a control, and the key that gives it; empty if there is none."""
    if not isinstance(control, PDSpec):
        return "", ()
    if isinstance(control.reference, CurveReference):
        return control.reference.curve.start, ("control", "reference", "curve", "start")
    return control.reference.gait, ("control", "reference", "gait")


def unsuitable(name: str, reference: ProblemStatement, walker: Walker) -> Iterator[str]:
    """Why a walker cannot track the gait of a problem, which its file calls ``name``."""
    words = f"the reference {shown(name)}"
    untracked = ", ".join(angle for angle in walker.tracked if angle not in reference.walker.shape)
    if untracked:
        yield f"{words} is a {reference.walker.model}, which has no {untracked} to track"
    if len(reference.cycle.steps) > 1:
        yield f"{words} has several steps, but its clock restarts at every impact: name a gait of one step"
