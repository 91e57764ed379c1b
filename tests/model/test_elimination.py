"""The linear system of contacts and stops, against NumPy's solver of the same equations."""

import numpy as np
import pytest
from casadi import Function, densify, vertcat

from gaitopt import Mode, Walker
from gaitopt.model.contacts import LOCKED, NORMAL, TANGENTIAL, constraint_structure
from gaitopt.model.control import NoControl
from gaitopt.model.friction import COULOMB, ImpactLaw, shared_friction
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.crawler import Crawler
from gaitopt.model.walkers.flat_foot import FlatFoot
from gaitopt.model.walkers.heel_toe import HeelToe
from gaitopt.model.walkers.hopper import Hopper
from gaitopt.model.walkers.kneed import KneedWalker
from gaitopt.model.walkers.slip_walker import SlipWalker
from gaitopt.model.walkers.torso import TorsoWalker

ONE_FOOT = (CompassBiped, Hopper, KneedWalker, TorsoWalker)
SEVERAL = (Crawler, FlatFoot, HeelToe, SlipWalker)
FRICTION = 0.3


def passive(walker: type[Walker], law: ImpactLaw = ImpactLaw.COULOMB) -> HybridSystem:
    friction = shared_friction(walker.contacts, COULOMB)
    return HybridSystem(walker, NoControl(), law, friction)


@pytest.mark.parametrize("walker", [*ONE_FOOT, *SEVERAL], ids=lambda walker: walker.model)
def test_the_motion_of_every_mode_satisfies_newtons_law_and_its_constraints(walker: type[Walker]) -> None:
    """M ddq + B + G + springs = J' f, J ddq + dJ dq = 0, and f_t = -s mu f_n of contacts that slip."""
    system, rng = passive(walker), np.random.default_rng(0)
    eom, names = system.expressions.eom, (*walker.shape, "x", "y")
    order = [walker.coordinates().index(name) if name in walker.coordinates() else -1 for name in names]
    n_p, n = len(walker.model_fields), len(walker.coordinates())
    contacts = walker.contact_names()
    modes = [mode for mode in system.transitions.modes if constraint_structure(walker, mode).is_determined]
    for mode in [modes[k] for k in rng.permutation(len(modes))[:12]]:
        structure = constraint_structure(walker, mode)
        kept = {structure.constraints[k] for k in structure.kept}  # the others follow where the contacts are on ground
        gradient = eom.force_of(system.expressions.potential_of(mode))
        points = [densify(eom.contacts[name].J) for name in contacts]
        convective = [densify(eom.contacts[name].convective) for name in contacts]
        locked = [densify(eom.gaps[name]) for name in mode.locked]
        parts = [densify(part) for part in (eom.M, eom.B + eom.G + gradient, vertcat(*points), vertcat(*convective))]
        evaluated = Function("parts", [eom.z, eom.p], [*parts, densify(vertcat(*locked, eom.M[:0, :]))])
        p, z = rng.uniform(0.5, 1.5, n_p), rng.uniform(-0.3, 0.3, system.n_z)
        M, load, J, dJdq, L = (np.asarray(value) for value in evaluated(z, p))
        known = [*p, FRICTION]
        dz = np.asarray(system.flow(mode)(0, z, known, [])).ravel()
        force = np.asarray(system.observation(mode)(0, z, known, [])[0]).ravel()
        ddq = np.array([0.0 if k < 0 else dz[n + k] for k in order])
        rest = M @ ddq + load.ravel() - J.T @ force  # forces of the stops
        size = np.abs(load).max() + np.abs(J.T @ force).max() + 1
        moving = [k for k, name in enumerate(names) if np.abs(M[k]).max() > 0 and (name != "y" or order[k] >= 0)]
        if mode.locked:
            multipliers = np.linalg.lstsq(L.T, rest, rcond=None)[0]
            rest = rest - L.T @ multipliers
            assert np.abs(L @ ddq).max() < 1e-9 * size
        if not (walker.massless_feet or walker.massless_contacts):
            assert np.abs(rest[moving]).max() < 1e-9 * size
        for k, name in enumerate(contacts):
            f_t, f_n = force[2 * k], force[2 * k + 1]
            if name not in mode.touching:
                assert f_t == f_n == 0
                continue
            acceleration = J[2 * k : 2 * k + 2] @ ddq + dJdq[2 * k : 2 * k + 2].ravel()
            for kind in (TANGENTIAL, NORMAL):
                assert (name, kind) not in kept or abs(acceleration[kind]) < 1e-9 * size
            if mode.directions[name]:
                assert f_t == pytest.approx(-mode.directions[name] * FRICTION * f_n, rel=1e-12, abs=1e-9 * size)


def test_a_locked_stop_is_a_constraint_of_its_mode() -> None:
    free, locked = Mode("stick, knee free"), Mode("stick, knee locked")
    assert ("knee", LOCKED) in constraint_structure(KneedWalker, locked).constraints
    assert len(constraint_structure(KneedWalker, free).constraints) == 2
