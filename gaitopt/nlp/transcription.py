"""The seam between the equations of a periodic gait and what solves, refines and examines them."""

from typing import NamedTuple, Protocol, Self

from casadi import MX

from gaitopt.arrays import Array
from gaitopt.mechanics import Dynamics, HybridSystem
from gaitopt.nlp.layout import Layout
from gaitopt.nlp.sparse import SparseMatrix
from gaitopt.nlp.units import Label, Units


class Unknowns(NamedTuple):
    """The parts of a vector w: nodes (n_z, K + 1), durations (n_phases,) and freed parameters."""

    nodes: Array
    durations: Array
    freed: Array


class Transcription(Protocol):
    """A gait as square equations and margins of unknowns w, with parameters p; see ``MultipleShooting``."""

    system: HybridSystem
    layout: Layout
    free: tuple[str, ...]
    n_nodes: int
    n_phases: int
    w: MX
    parameters: MX

    @property
    def equalities(self) -> MX:
        """What is zero at a gait, in terms of ``w`` and ``parameters``; shape (n,)."""

    @property
    def inequalities(self) -> tuple[MX, tuple[Label, ...]]:
        """Margins that must not be negative, and what each one says."""

    def on(self, layout: Layout) -> Self:
        """The same equations on another layout."""

    def pack(self, nodes: Array, durations: Array, freed: Array | tuple[float, ...] = ()) -> Array:
        """The vector w from nodes (n_z, K + 1), durations (n_phases,) and freed parameters."""

    def unpack(self, w: Array) -> Unknowns:
        """What a vector w consists of."""

    def dynamics(self, p: Array, freed: Array, phase: int = 0) -> Dynamics:
        """The system at its parameters with the freed ones put in, in the step of a phase."""

    def units(self, p: Array) -> Units:
        """Natural units of unknowns and equalities."""

    def margin_units(self, p: Array) -> Array:
        """Natural units of the inequalities."""

    def violation(self, w: Array, p: Array) -> Array:
        """Values of the equalities."""

    def linearised(self, w: Array, p: Array) -> tuple[Array, SparseMatrix]:
        """Values of the equalities, and their derivative in all unknowns; shape (n, n + n_free)."""

    def margin_values(self, w: Array, p: Array) -> Array:
        """Values of the inequalities."""

    def halved_defects(self, w: Array, p: Array) -> Array:
        """By how much a finer integration would change the equalities."""

    def node_times(self, w: Array) -> Array:
        """Time since impact of every node; shape (K + 1,) [s]."""

    def sample(self, w: Array, p: Array, index: int, count: int) -> tuple[Array, Array]:
        """Times (count,) and states (count, n_z) at the Chebyshev points of one arc."""

    def states_at(self, w: Array, p: Array, index: int, fractions: Array) -> Array:
        """States (m, n_z) at fractions of one arc."""
