"""The gaits and families of the paper: their problems, and the archive that computes and stores them.

The named problems are our reading of the paper; every other gait is one of them with a few values changed. The
torques with which a walker on level ground copies the joint angles of a walk down a slope (Fig. 10) follow from

    E_s u = G_s(q; level) - G_s(q; slope)             rows s of the shape coordinates

because the slope enters the equations of motion (2) only through G, and the contact force acts only in the rows of x
and y.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from casadi import Function
from numpy.polynomial import Chebyshev
from numpy.typing import NDArray

import gaitopt as go
from gaitopt.building import built_once
from gaitopt.errors import SolveError

Array = NDArray[np.float64]
Records = list[dict[str, Any]]
"""The request of a family and its points and special points, as ``gaitopt.load_records`` returns them."""

PARAMETER = "friction"
"""The parameter of all families."""
RESULTS = Path("results")
"""Folder of the run folders."""
ENDS = ("end", "vanishing", "lift_off", "painleve")
"""Types of special points at which a family ends."""
FRICTIONLESS: Mapping[str, Any] = MappingProxyType({"impact_law": "frictionless"})
PRINTED_TORQUES: Mapping[str, tuple[float, float]] = MappingProxyType({"I": (-2.73, 0.54), "II": (-0.69, 0.12)})
"""tau1 and tau2 as printed [N m]."""
HALF_DIGIT_OF_TORQUE = 0.005
"""Largest rounding error of the printed torques [N m]."""
CORNERS = tuple(product((-1, 1), repeat=2))
"""Signs of the rounding errors of both torques at the corners of their range."""


def torques_here(tau1: float, tau2: float) -> dict[str, float]:
    """Printed torques in the sign convention of gaitopt (see ``docs/conventions.md``)."""
    return {"control.ankle": -tau1 - 2 * tau2, "control.hip": tau2}


SOURCES: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "wheel": ("rimless-wheel-stick", {}),
    "wheel slipping": ("rimless-wheel-slip", {}),
    "passive": ("compass-passive-stick", {}),
    "passive, leg as printed": (
        "compass-passive-stick",
        {
            "walker.leg_length": 0.8,
            "walker.leg_com": 0.5,
            "friction": 1.0,
            "gait.guess.state.theta1": -0.15,
            "gait.guess.state.dtheta1": 0.996,
            "gait.guess.state.dtheta2": -0.43,
        },
    ),
    "A": ("compass-passive-a", {}),
    "B": ("compass-passive-b", {}),
    "B, frictionless impact": ("compass-passive-b", FRICTIONLESS),
    "I": ("compass-torque-stick", {}),
    "II": ("compass-torque-impact-slip", {}),
    "II, frictionless impact": ("compass-torque-impact-slip", FRICTIONLESS),
    "III": ("compass-pd-impact-slip", {}),
    **{
        f"III, {end}": ("compass-pd-impact-slip", {"control.reference.beyond_end": end})
        for end in ("linear", "hold", "off")
    },
}
"""The named problem behind every gait that a figure or a number needs, and the values that differ from it."""

FAMILIES: Mapping[str, tuple[float, ...]] = {
    "II, frictionless impact": (0.1, 0.3),
    "B, frictionless impact": (0.1, 0.35),
    "passive": (0.1,),
    "I": (0.09,),
    "II": (0.1, 0.3),
    "wheel": (0.1,),
    "B": (0.1, 0.35),
    "III": (0.05, 0.5),
}
"""Coefficients of friction towards which these gaits are continued, in the order of increasing computing time."""
ROUNDED = ("I", "II, frictionless impact")
"""Gaits that depend on rounded printed torques."""


CONTROLLED = {
    "I": "I, constant torques",
    "II": "II, weak torques",
    "II, frictionless impact": "II, frictionless impact",
    "III": "III, PD law",
}
SHOWN: Mapping[str, Mapping[str, str]] = {
    "fig2": {"wheel": "no slip, μ = 1", "wheel slipping": "stick-slip, μ = 0.4"},
    "fig3": {"wheel": "no slip"},
    "fig4": {"wheel": "wheel"},
    "fig6": {"passive": "no slip"},
    "fig7": {"passive": "passive", "I": "gait I"},
    "fig8": {"A": "A", "B": "B"},
    "fig8-frictionless": {"A": "A", "B, frictionless impact": "B, frictionless impact"},
    "fig9": {
        "passive": "sticking impact (A)",
        "B": "slipping impact (B)",
        "B, frictionless impact": "B, frictionless impact",
    },
    "fig10": {"passive": "passive", "I": "gait I"},
    "fig11": CONTROLLED,
    "fig12": CONTROLLED,
}
"""Gaits in each figure, and their names in its legend."""


class Archive:
    """Gaits and families that are stored in run folders; nothing is computed twice.

    Parameters
    ----------
    results : folder of the run folders.
    narrate : called with a description of the next computation.
    should_stop : polled while computing; True ends a computation with a ``KeyboardInterrupt``.
    """

    def __init__(
        self,
        results: Path = RESULTS,
        *,
        narrate: Callable[[str], None] = lambda description: None,
        should_stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self.results, self.narrate, self.should_stop = results, narrate, should_stop
        self._gaits: dict[str, go.Gait] = {}
        self._families: dict[Path, Records] = {}

    def gait(self, problem: go.Problem) -> go.Gait:
        """The verified gait of a problem.

        Raises
        ------
        SolveError
            If no gait is found, or the forward simulation refutes it.
        StorageError
            If its run folder is damaged, contains another problem, or cannot be written.
        """
        if problem.digest not in self._gaits:
            if not self.has_gait(problem):
                self.narrate(f"solving {_description(problem)}")
            folder = self._folder(problem)
            gait = go.solve(problem, output=folder, reuse=True, progress=False, should_stop=self.should_stop)
            if self.should_stop():
                raise KeyboardInterrupt
            if not gait.converged:
                raise SolveError(f"{problem.name} is {gait.status}: {gait.message}")
            if gait.verification is None or not gait.verification["passed"]:
                raise SolveError(
                    f"{problem.name}: the forward simulation refutes the gait; see gaitopt verify {folder}"
                )
            self._gaits[problem.digest] = gait
        return self._gaits[problem.digest]

    def has_gait(self, problem: go.Problem) -> bool:
        """Whether the gait has been computed."""
        return problem.digest in self._gaits or (self._folder(problem) / "gait.json").is_file()

    def family(self, problem: go.Problem, to: Sequence[float]) -> Records:
        """Records of the family of a problem's gait, continued in friction towards each value of ``to``.

        A family whose computation was interrupted is resumed.
        """
        folder = self._family_folder(problem, to)
        if not self.has_family(problem, to):
            gait = self.gait(problem)
            targets = " and ".join(f"{value:g}" for value in to)
            self.narrate(f"continuing {_description(problem)} in {PARAMETER} to {targets}")
            points = go.continuation_records(gait, PARAMETER, to, output=folder, should_stop=self.should_stop)
            self._families[folder] = list(points)
        return self._families[folder]

    def has_family(self, problem: go.Problem, to: Sequence[float]) -> bool:
        """Whether the family has been computed towards all targets."""
        folder = self._family_folder(problem, to)
        if folder not in self._families and (folder / "branch.jsonl").is_file():
            head, *records = go.load_records(folder)
            ends = [record for record in records if record.get("type") in ENDS and not record.get("open")]
            if head.get("to") == [*to] and len(ends) >= len(to):
                self._families[folder] = [head, *records]
        return folder in self._families

    def _folder(self, problem: go.Problem) -> Path:
        """The run folder of a problem, which need not exist yet."""
        return self.results / f"{problem.name}-{problem.hash8}"

    def _family_folder(self, problem: go.Problem, to: Sequence[float]) -> Path:
        folder = self._folder(problem)
        return folder.with_name("-".join((folder.name, PARAMETER, "_".join(f"{value:g}" for value in to))))


def _description(problem: go.Problem) -> str:
    """Name of a problem with the values that distinguish it from others of this name."""
    return f"{problem.name} (friction {problem.friction_data}, {problem.impact_law} impact)"


@lru_cache
def problem_of(name: str) -> go.Problem:
    """The problem behind a short name."""
    source, changes = SOURCES[name]
    problem = go.load_problem(source)
    return problem.replace(changes) if changes else problem


def gait_of(archive: Archive, name: str) -> go.Gait:
    """The gait with a short name of ``SOURCES``."""
    return archive.gait(problem_of(name))


def family_of(archive: Archive, name: str) -> Records:
    """The family over the coefficient of friction that starts at the gait with a short name."""
    return archive.family(problem_of(name), FAMILIES[name])


def rounded_torques(archive: Archive, name: str) -> list[go.Gait]:
    """Gait I or II at the four corners of the range of torques that round to the printed ones."""
    tau1, tau2 = PRINTED_TORQUES[name.partition(",")[0]]
    corners = [torques_here(tau1 + a * HALF_DIGIT_OF_TORQUE, tau2 + b * HALF_DIGIT_OF_TORQUE) for a, b in CORNERS]
    return [archive.gait(problem_of(name).replace(corner)) for corner in corners]


def copied_torques(gait: go.Gait) -> list[tuple[Array, Array]]:
    """Times (m,) [s] and torques (m, n_u) [N m] that copy a gait on level ground, for every arc of the gait.

    The walker needs as many motors as shape coordinates.
    """
    walker = gait.problem.walker
    terms = _gravity_and_motors(type(walker))
    fields = {name: getattr(walker, name) for name in type(walker).model_fields}
    sloping, level = list(fields.values()), list({**fields, "slope": 0.0}.values())

    def torque(z: Array) -> Array:
        (there, E), (here, _) = terms(z, sloping), terms(z, level)
        return np.linalg.solve(np.asarray(E), np.asarray(here - there)).ravel()

    return [(arc.times, np.array([torque(z) for z in arc.states])) for arc in gait.arcs]


@built_once(maxsize=8)
def _gravity_and_motors(walker: type[go.Walker]) -> Function:
    """(z, p) -> G and E of the shape coordinates in the equations of motion."""
    equations, shape = go.equations_of_motion(walker), len(walker.shape)
    return Function("terms", [equations.z, equations.p], [equations.G[:shape], equations.E[:shape, :]])


def mean_torques(gait: go.Gait) -> Array:
    """Means of the copied torques over the step; shape (n_u,) [N m]."""
    total = np.zeros(len(gait.system.walker.actuators))
    for times, torques in copied_torques(gait):
        for k, values in enumerate(torques.T):  # the interpolant at Chebyshev points is as accurate as the gait
            antiderivative = Chebyshev.fit(times, values, len(times) - 1).integ()
            total[k] += antiderivative(times[-1]) - antiderivative(times[0])
    return total / gait.scalar("period")
