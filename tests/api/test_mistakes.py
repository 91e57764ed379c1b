"""Each of the usual mistakes gets one sentence that says what to write instead."""

from dataclasses import replace

import numpy as np
import pytest
from casadi import SX, vertcat
from named import named
from refusals import refusal

import gaitopt as go
from gaitopt.cli.main import main
from gaitopt.display import distinguished
from gaitopt.errors import GaitoptWarning
from gaitopt.gait.measures import observe
from gaitopt.model.mechanism import inclined, polar
from gaitopt.model.walkers.rimless_wheel import RimlessWheel
from gaitopt.show.tables import enclosure

PASSIVE = "compass-passive-a"
WHEEL = {"spokes": 10, "radius": 1.0, "mass": 1.0, "inertia_ratio": 0.3, "gravity": 1.0, "slope": 0.2}


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: go.simulate(PASSIVE, [1, 2]), "has no names; write {'theta1': 0.1, ...}, of theta1, dtheta1, dtheta2"),
        (lambda: go.simulate(PASSIVE, 3), "or steps=3 for the number of steps"),
        (lambda: go.simulate("heel-toe", [1, 2]), "has no names; write {"),
        (lambda: go.simulate(PASSIVE, steps="3"), "must be a whole number"),
        (lambda: go.parse_problem({}), "reads a YAML text, which is missing"),
        (lambda: go.load_problem(PASSIVE).replace(friction=0.1), "replace({'friction': 0.1})"),
        (lambda: go.load_problem(PASSIVE).replace("friction"), "replace({'friction': 0.16})"),
        (lambda: go.parse_problem(path="x"), "load_problem('x') reads a file"),
        (lambda: go.load_problem(PASSIVE).replace({"mu": 0.1}), "mu: unknown key; did you mean friction?"),
        (lambda: go.load_problem(PASSIVE).replace({"walker.slope": 2}), "did you mean 2 deg?"),
        (lambda: go.verify(PASSIVE), "verify takes a gait, not a problem; give solve('compass-passive-a')"),
        (lambda: go.continuation(go.load_problem(PASSIVE), "friction", 0.1), "not a problem; give solve(problem)"),
        (lambda: go.solve(named(PASSIVE)), "its name or its path, not a Gait; its problem is gait.problem"),
        (lambda: go.find(["stick"]), "expected a problem, its name or its path, not a list"),
        (lambda: go.plot(PASSIVE), "plot takes a gait, not a problem; give solve('compass-passive-a')"),
        (lambda: go.animate(PASSIVE), "not a problem; give solve('compass-passive-a')"),
        (lambda: go.save_figures(PASSIVE, "figures"), "not a problem; give solve('compass-passive-a')"),
        (lambda: go.report(go.load_problem(PASSIVE)), "report takes a gait, not a problem; give solve(problem)"),
        (lambda: go.neighbourhood(PASSIVE), "neighbourhood takes a gait, not a problem"),
        (lambda: go.return_map(PASSIVE, [[0.1]]), "give load_problem('compass-passive-a')"),
        (lambda: go.parse_problem("my.yaml"), "load_problem('my.yaml') reads a file"),
        (lambda: go.sweep(PASSIVE, {"friction": (0.3, 0.3, 4)}), "friction"),
    ],
)
def test_a_wrong_call_names_the_right_one(call, words):
    assert words in refusal(call)


def test_a_class_without_model_and_a_misspelt_coordinate_are_named():
    class Nameless(go.Walker):
        shape = ("theta",)

        @classmethod
        def mechanism(cls, q, p):
            raise NotImplementedError

    class Misspelt(RimlessWheel):
        model = "misspelt"

        @classmethod
        def mechanism(cls, q, p):
            return go.Mechanism(bodies=(), gravity=q.thta, upright=SX(1))

    assert 'write model = "NAME" in its body' in refusal(go.check_walker, Nameless, WHEEL)
    assert "nothing is called thta; did you mean theta?" in refusal(go.check_walker, Misspelt, WHEEL)


def wheel(**body):
    class Wheel(RimlessWheel):
        model = "own_wheel"

        @classmethod
        def mechanism(cls, q, p):
            hub, half = vertcat(q.x, q.y) + polar(p.radius, q.theta), np.pi / p.spokes
            entries = {key: value(q, p) for key, value in body.items()}
            return go.Mechanism(
                bodies=(go.Body(mass=p.mass, position=hub, **entries),),
                gravity=inclined(p.gravity, p.slope),
                swing_foot=hub - polar(p.radius, q.theta - 2 * half),
                touchdown=q.theta - half,
                upright=q.theta + half,
                relabel=SX(q.theta - 2 * half),
            )

    return Wheel


def test_a_forgotten_inertia_is_remarked():
    def angle(q, p):
        return q.theta

    def inertia(q, p):
        return p.mass * p.radius**2

    with pytest.warns(GaitoptWarning, match="body 0 has an angle, but no inertia"):
        go.check_walker(wheel(angle=angle), WHEEL)
    with pytest.warns(GaitoptWarning, match="body 0 has an inertia, but no angle"):
        go.check_walker(wheel(inertia=inertia), WHEEL)
    go.check_walker(wheel(angle=angle, inertia=inertia), WHEEL)  # warnings are errors


@pytest.mark.slow
@pytest.mark.parametrize("quiet", [[], ["--quiet"]])
def test_explain_says_that_friction_is_below_the_slope(capsys, quiet):
    main(["explain", "rimless-wheel-slip", "--set", "friction=0.2", "--starts", "1", *quiet])
    assert "friction 0.2 is less than tan(slope) = 0.2309: no steady gait" in capsys.readouterr().out


def test_numbers_that_are_compared_differ_in_what_is_printed():
    assert distinguished(0.17491, 0.17489) == ("0.17491", "0.17489")
    assert distinguished(0.1, 0.3) == ("0.1", "0.3")
    assert distinguished(1.0, np.nextafter(1.0, 2.0)) == ("1", "1.0000000000000002")


def test_a_bound_of_a_proof_is_rounded_to_what_is_known():
    assert enclosure("0.79112632280773640", "0.79112632280773834") == "0.791126322807737 ± 1e-15"
    assert enclosure("0.000000", "0.000000") == "0"
    assert enclosure("1", "3") == "2 ± 1"


def test_a_gait_says_whether_it_is_stable_a_failed_one_why_it_failed_and_a_walk_whether_it_took_its_steps():
    failed = go.solve(go.load_problem("rimless-wheel-stick").replace({"walker.slope": 0.0}), progress=False)
    assert failed.period is None
    assert failed.stable is None
    assert failed.to_record()["period"] is None
    assert f"{failed.status}: {failed.message}" in repr(failed)
    gait = named("rimless-wheel-slip")
    assert gait.stable is True
    assert go.simulate(gait, steps=2).completed
    assert not go.simulate(gait, {"dtheta": 1e-3}, steps=2).completed


def test_apex_height_is_that_of_the_landing_and_the_clearance_of_the_foot():
    """The leg of the runner is held at its angle of attack in flight, so that its foot rises as its mass does."""
    gait = named("slip-run")
    landing = np.sin(gait.scalar("walker.attack")) * gait.scalar("walker.leg_length")
    assert gait.scalar("apex_height") == pytest.approx(landing + gait.scalar("foot_clearance"), rel=1e-9)
    assert named("compass-passive-a").measures["apex_height"] is None


def test_gravity_pays_the_energy_that_a_step_downhill_frees():
    """The same posture one step further has less energy: that part of weight times step length is the cost."""
    gait = named("compass-passive-a")
    arc = gait.arcs[0]
    moved = arc.states[:1] + gait.scalar("step_length") * np.eye(gait.system.n_z)[gait.system.n_shape]
    freed = observe(arc).energy[0] - observe(replace(arc, states=moved, times=arc.times[:1])).energy[0]
    weight = gait.scalar("walker.gravity") * (2 * gait.scalar("walker.leg_mass") + gait.scalar("walker.hip_mass"))
    assert gait.scalar("gravity_cost") == pytest.approx(freed / (weight * gait.scalar("step_length")), rel=1e-9)
    assert gait.scalar("gravity_cost") == pytest.approx(np.sin(np.radians(1)), rel=1e-12)
    assert gait.measures["cost_of_transport"] == 0
