"""Gaits replayed in engines: convergence to the gait, closed forms, refusals, crashes, kept results."""

import json
import os
import runpy
import subprocess
import sys
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import psutil
import pytest

import gaitopt as go
from gaitopt.api.stored import stored_replays
from gaitopt.cli.main import main
from gaitopt.engines import replay as engines
from gaitopt.engines.outcome import Outcome, run
from gaitopt.engines.plant import Reference
from gaitopt.errors import ProblemError, StorageError, UnknownNameError
from gaitopt.gait import curves
from gaitopt.gait.measures import observe
from gaitopt.simulation.simulator import Simulator as WalkerSimulator

ROOT = Path(__file__).parents[2]
for place in (ROOT / "docs" / "examples", Path(__file__).parent):
    sys.path.insert(0, str(place))

from crashing_engines import Crashing, Diverging, Failing, Hanging  # noqa: E402
from numpy_engine import Simulator  # noqa: E402

VALIDATION = runpy.run_path(str(ROOT / "benchmarks" / "engines" / "validation.py"))
CASES, PERTURBATIONS = VALIDATION["CASES"], VALIDATION["PERTURBATIONS"]
INSTALLED = [name for name, package in engines.ENGINES.items() if find_spec(package) is not None]
TOLERANCES = {"block slides to rest": 5e-3, "pendulum": 1e-2, "plastic impact": 0.02}
LONG_ENOUGH = 120
"""Seconds within which a process ends on the busiest machine."""
REBOUND = {"mujoco": 0.15}
"""A contact whose time constant is twice the time step rebounds, whatever its size."""


def outcome(name, simulator, dt, settings):
    return run(Reference(go.solve(name, progress=False)), simulator, dt, settings)


def test_a_simulator_of_ones_own_converges_to_the_gait():
    coarse, fine = (outcome("compass-passive-a", Simulator, dt, {"sweeps": 5}) for dt in (4e-3, 2e-3))
    assert fine.ending == "completed"
    assert fine.state_error < 0.5 * coarse.state_error < 5e-3
    assert fine.error_before_impact < 0.4 * coarse.error_before_impact < 1e-3  # of second order
    assert fine.sequence == (("slip_forward", "stick", "slip_backward"),)
    assert fine.sequence_matches
    assert fine.slip["slip_forward"] == pytest.approx(4.05e-3, rel=0.01)
    assert fine.impact_error < 0.005
    assert fine.creep < 1e-5


@pytest.mark.parametrize(
    "name",
    [
        "compass-unequal",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in (
                "round-feet-passive",
                "compass-pd-impact-slip",
                "torso-passive",
                "torso-upright",
                "rimless-wheel-slip",
            )
        ),
    ],
)
def test_cycles_of_two_steps_control_laws_springs_and_round_feet_are_replayed(name):
    fine = outcome(name, Simulator, 2e-3, {"sweeps": 5})
    assert fine.ending == "completed"
    assert fine.state_error < 0.02
    assert fine.sequence_matches


@pytest.mark.parametrize("name", ["crawler", pytest.param("inchworm", marks=pytest.mark.slow)])
def test_walkers_with_several_contacts_and_a_clock_are_replayed(name):
    """Both contacts are compared, each with friction of its own.

    With other friction the engine leaves the gait, and follows the walk that the simulator finds with this friction. A
    tenth more friction moves the inchworm by less than one percent of its length, which is 3.6 times the error of the
    engine.
    """
    coarse, fine = (outcome(name, Simulator, dt, {"sweeps": 50}) for dt in (8e-3, 4e-3))
    assert fine.ending == "completed"
    assert fine.error_before_impact < 0.6 * coarse.error_before_impact < 0.01
    assert fine.state_error < 0.005
    assert [len(steps) for steps in (fine.sequence, coarse.sequence)] == [2, 2]
    assert fine.impact_error is None
    paths = engines.slip_paths(go.solve(name, progress=False).steps)
    assert fine.slip["slip_forward"] == pytest.approx(paths["slip_forward"], rel=0.02)
    wrong = outcome(name, Simulator, 4e-3, {"sweeps": 50, "friction": 1.1})
    assert wrong.error_before_impact > 3.5 * fine.error_before_impact
    gait = go.solve(name, progress=False)
    coefficients = [key for key in gait.dynamics.parameters if key.startswith("friction")]
    rougher = gait.dynamics.at({key: 1.1 * gait.dynamics.parameters[key] for key in coefficients})
    walked = replace(gait, dynamics=rougher, steps=WalkerSimulator(rougher).run(gait.state, dense=True).steps)
    followed = run(Reference(walked), Simulator, 4e-3, {"sweeps": 50})
    assert followed.error_before_impact < fine.error_before_impact


@pytest.mark.slow
@pytest.mark.skipif("mujoco" not in INSTALLED, reason="needs pip install '.[engines]'")
def test_a_foot_that_leaves_fast_along_the_ground_is_thrown_up_by_a_convex_contact_law():
    """MuJoCo lets contacts move at v_n >= mu |v_t|; the law of Coulomb does not, and replays this gait."""
    gait = go.solve("compass-passive-two-step", progress=False)
    for step in gait.steps:
        arc = step.arcs[0]
        leaving = curves.slopes(observe(arc).swing_foot, curves.points(arc.times.size))[0] * 2 / arc.duration
        assert 0 < leaving[1] < 0.35 * gait.dynamics.static_friction * leaving[0]
    mujoco = engines.adapter("mujoco")
    own, convex = (
        outcome("compass-passive-two-step", simulator, 1e-3, settings)
        for simulator, settings in ((Simulator, {"sweeps": 20}), (mujoco, mujoco.settings["best"]))
    )
    assert own.sequence_matches
    assert own.state_error < 0.02
    assert convex.state_error > 5 * own.state_error


@pytest.mark.parametrize("name", ["heel-toe", pytest.param("heel-toe-slip", marks=pytest.mark.slow)])
def test_walkers_that_roll_over_heel_and_toe_are_replayed(name):
    """The toe lands within the step, the heel of the other foot ends it, and both feet swap roles."""
    coarse, fine = (outcome(name, Simulator, dt, {"sweeps": 50}) for dt in (8e-3, 2e-3))
    assert fine.ending == "completed"
    assert fine.error_before_impact < 0.4 * coarse.error_before_impact < 0.04
    assert fine.impact_error < 0.02
    assert fine.creep < 0.3 * coarse.creep
    assert fine.sequence_matches or name != "heel-toe"
    assert fine.sequence[2:] == (("off",), ("off",))


@pytest.mark.slow
def test_a_flat_foot_converges_to_the_gait():
    """Contacts of one foot share its force. Its ankle turns at 18 rad/s while it stands on the heel, which creeps."""
    coarse, fine = (outcome("flat-foot", Simulator, dt, {"sweeps": 100}) for dt in (1e-3, 5e-4))
    assert np.abs(fine.deviation[:2]).max() < 0.1 * np.abs(coarse.deviation[:2]).max() < 0.004
    assert fine.creep < 0.5 * coarse.creep
    assert fine.sequence[0] == ("slip_forward", "stick")


CRAWLING = (  # MuJoCo and SAP let a contact that slips at v leave the ground at mu v: it hops, at every time step
    ("mujoco", {}, False),
    ("drake", {}, False),
    ("drake", {"solver": "lagged", "stiction": 1e-6}, True),
    ("pybullet", {}, True),
    ("siconos", {}, True),
)


@pytest.mark.slow
@pytest.mark.parametrize(("engine", "changes", "verdict"), [case for case in CRAWLING if case[0] in INSTALLED])
def test_an_engine_without_a_convex_contact_law_converges_to_the_closed_form_of_the_crawler(engine, changes, verdict):
    setting = {"s": {**engines.adapter(engine).settings["best"], **changes}}
    (result,) = go.replay("crawler", engine, settings=setting, time_steps=STEPS, progress=False)
    assert result.consistent is verdict, result.consistent_reason


@pytest.mark.slow
@pytest.mark.parametrize("engine", sorted({"mujoco", "drake"} & {*INSTALLED}))
def test_a_contact_that_slips_hops_in_engines_with_a_convex_contact_law(engine):
    """It leaves the ground at mu v and is in the air for 2 mu v / g_n, whatever the time step."""
    reference, simulator, mu = Reference(go.solve("crawler", progress=False)), engines.adapter(engine), 0.4
    fall, counts = -reference.tree.gravity[1], []
    for dt in (5e-4, 2.5e-4):
        walk = simulator(reference.tree, reference.friction, dt, simulator.settings["best"])
        (q, v), air, flights = reference.coordinates(0.0), [], []
        walk.place(q, v)
        for k in range(int(0.3 / dt)):
            air.append(v[0] + v[2])  # speed of the front
            q, v, forces = walk.step(reference.torques(0, k * dt, q, v), (True, True))
            if forces[1, 1] > 0:
                flights += [(len(air) * dt, 2 * mu * air[0] / fall)] if len(air) * dt > 4e-3 else []
                air = []
        counts.append(len(flights))
        measured, expected = np.array(flights).T
        assert measured.mean() == pytest.approx(expected.mean(), rel=0.3)
    assert counts[1] == pytest.approx(counts[0], rel=0.35)


@pytest.mark.slow
@pytest.mark.parametrize("engine", sorted({"pybullet", "siconos"} & {*INSTALLED}))
def test_an_engine_with_the_law_of_coulomb_crawls_like_an_inchworm(engine):
    (result,) = go.replay("inchworm", engine, settings="best", time_steps=[1e-3, 5e-4], progress=False)
    coarse, fine = result.outcomes
    assert fine.sequence_matches
    assert fine.error_before_impact == pytest.approx(0.5 * coarse.error_before_impact, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("engine", sorted({"mujoco", "drake", "pybullet"} & {*INSTALLED}))
def test_an_engine_rolls_over_heel_and_toe(engine):
    (result,) = go.replay("heel-toe", engine, settings="best", time_steps=[1e-3, 5e-4], progress=False)
    coarse, fine = result.outcomes
    assert fine.sequence_matches
    assert fine.error_before_impact < 0.7 * coarse.error_before_impact < 3e-3
    assert fine.impact_error < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("engine", sorted({"mujoco", "drake"} & {*INSTALLED}))
def test_an_engine_moves_the_crawler_as_far_as_its_closed_form(engine):
    (result,) = go.replay("crawler", engine, settings="best", time_steps=[2e-3, 1e-3])
    for found in result.outcomes:
        assert found.sequence_matches
        assert found.slip["slip_forward"] == pytest.approx(result.slip["slip_forward"], rel=0.005)


def test_a_foot_that_cannot_hold_is_noticed():
    slippery = outcome("compass-passive-stick", Simulator, 4e-3, {"sweeps": 5, "friction": 0.8})
    assert not slippery.sequence_matches
    assert slippery.slip_invented > 0.02


STEPS = [4e-3, 2e-3, 1e-3, 5e-4]


def judged(error, slip=0.0, endings=None, steps=STEPS, effect=0.1):
    """The judgement of an engine with errors of first and second order, and these as the time step tends to zero."""
    outcomes = tuple(
        Outcome(
            dt=dt,
            ending="completed" if endings is None else endings[k],
            deviation=tuple(np.array([error, 0.1 * error, 0.0, 0.0]) + 0.3 * dt + 2.0 * dt**2),
            slip={"slip_forward": 4e-3 * (1 + slip + 20 * dt + 400 * dt**2), "slip_backward": 1e-5},
        )
        for k, dt in enumerate(steps)
    )
    slips, effect = {"slip_forward": 4e-3, "slip_backward": 0.0}, {"slip_forward": effect}
    return engines.Replay(
        problem="p", engine="e", version="1", setting="s", settings={}, slip=slips, friction_effect=effect,
        outcomes=outcomes,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("error", "slip", "name"),
    [(0.0, 0.0, ""), (1e-4, 0.0, "angle of a body"), (-1e-4, 0.0, "angle"), (0.0, 0.04, "slip forward")],
)
def test_an_engine_is_consistent_if_and_only_if_its_errors_tend_to_zero(error, slip, name):
    result = judged(error, slip)
    assert result.consistent is not bool(name)
    limit = "as the time step tends to zero" if name else "all errors tend to zero with the time step"
    assert name in result.consistent_reason
    assert limit in result.consistent_reason
    record = result.to_record()
    assert (record["consistent"], record["consistent_reason"]) == (result.consistent, result.consistent_reason)


def test_runs_that_do_not_tell_are_neither():
    failing = ["completed", "completed", "diverged", "completed"]
    assert judged(0.0, endings=failing).consistent is None
    assert "time step of 0.001 s ended: diverged" in judged(0.0, endings=failing).consistent_reason
    few = judged(0.0, steps=STEPS[:3])
    assert (few.consistent, few.consistent_reason) == (None, "3 time steps; the extrapolation needs 4")
    coarse = judged(0.0, steps=[0.1, 0.05, 0.025, 0.0125])
    assert coarse.consistent is None
    assert "does not converge" in coarse.consistent_reason
    weak = judged(0.0, effect=0.011)
    assert (weak.consistent, "wrong by 1 % would not be noticed" in weak.consistent_reason) == (None, True)
    assert judged(0.0, effect=1e-6).consistent is True  # friction does not matter


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "verdict"), [(1.0, True), (1.01, False), (0.99, False)])
def test_friction_that_is_wrong_by_one_percent_is_not_consistent(factor, verdict):
    settings = {"s": {"sweeps": 5, "friction": factor}}
    (result,) = go.replay("compass-torque-slip", Simulator, settings=settings, time_steps=STEPS, progress=False)
    assert result.outcomes[-1].ending == "completed"
    assert result.consistent is verdict, result.consistent_reason


@pytest.mark.skipif("pybullet" not in INSTALLED, reason="needs pip install '.[engines]'")
def test_an_engine_with_friction_that_is_wrong_by_one_percent_is_not_consistent():
    best = engines.adapter("pybullet").settings["best"]
    settings = {f"{factor}": best | {"friction": factor} for factor in (1.0, 1.01)}
    replays = go.replay("compass-passive-a", "pybullet", settings=settings, time_steps=STEPS, progress=False)
    assert [result.consistent for result in replays] == [True, False]
    assert all(result.outcomes[-1].sequence_matches for result in replays)  # which says nothing


@pytest.mark.slow
@pytest.mark.parametrize("engine", INSTALLED)
@pytest.mark.parametrize("name", ["compass-passive-a", "rimless-wheel-slip", "compass-torque-slip"])
def test_an_engine_with_its_best_setting_is_consistent_and_with_wrong_friction_never(engine, name):
    """MuJoCo and Drake do not resolve the slip of the wheel, a tenth of a millimetre."""
    best, gait = engines.adapter(engine).settings["best"], go.solve(name, progress=False)
    settings = {f"{factor}": best | {"friction": factor} for factor in (1.0, 1.01, 0.99)}
    right, *wrong = (result.consistent for result in go.replay(gait, engine, settings=settings, progress=False))
    assert right is not False
    assert True not in wrong
    if name != "rimless-wheel-slip":
        assert (right, *wrong) == (True, False, False)


def test_gravity_that_is_wrong_in_the_fourth_digit_is_noticed():
    right, wrong = (
        outcome("compass-passive-stick", Simulator, 2e-3, {"sweeps": 20, "gravity": g}) for g in (1.0, 1.0005)
    )
    assert np.abs(np.subtract(right.deviation, wrong.deviation)).max() > 1e-4


@pytest.mark.parametrize("case", CASES)
def test_the_template_reproduces_closed_forms(case):
    measured, exact = CASES[case](Simulator, 2e-3, {"sweeps": 50})
    assert measured == pytest.approx(exact, rel=0.03)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("engine", INSTALLED)
def test_an_engine_reproduces_closed_forms(engine, case):
    simulator = engines.adapter(engine)
    measured, exact = CASES[case](simulator, 1e-3, simulator.settings["best"])
    tolerance = REBOUND.get(engine, 0.0) if case == "plastic impact" else 0.0
    assert measured == pytest.approx(exact, rel=max(TOLERANCES[case], tolerance))


@pytest.mark.parametrize("engine", INSTALLED)
def test_the_best_setting_of_an_engine_converges_to_the_gait_before_its_impact(engine):
    simulator = engines.adapter(engine)
    coarse, fine = (outcome("compass-passive-a", simulator, dt, simulator.settings["best"]) for dt in (1e-3, 5e-4))
    assert fine.sequence_matches
    assert fine.error_before_impact == pytest.approx(0.5 * coarse.error_before_impact, rel=0.3)
    limit = 2 * fine.slip["slip_forward"] - coarse.slip["slip_forward"]
    assert limit == pytest.approx(4.050e-3, rel=0.005)


@pytest.mark.slow
@pytest.mark.parametrize("engine", INSTALLED)
def test_a_perturbed_engine_is_flagged_and_the_unperturbed_one_is_not(engine):
    reference, simulator = Reference(go.solve("compass-passive-a", progress=False)), engines.adapter(engine)
    best, changes = simulator.settings["best"], PERTURBATIONS | (VALIDATION["OF_MUJOCO"] if engine == "mujoco" else {})
    assert not VALIDATION["is_flagged"](reference, simulator, best)
    passed = [
        name for name, change in changes.items() if not VALIDATION["is_flagged"](reference, simulator, best | change)
    ]
    assert passed == []


@pytest.mark.skipif("mujoco" not in INSTALLED, reason="needs pip install '.[engines]'")
def test_the_defaults_of_mujoco_converge_to_another_slip():
    simulator = engines.adapter("mujoco")
    coarse, fine = (outcome("compass-passive-a", simulator, dt, simulator.settings["default"]) for dt in (1e-3, 5e-4))
    limit = 2 * fine.slip["slip_forward"] - coarse.slip["slip_forward"]
    assert limit > 4.3e-3
    assert fine.creep > 10e-6


@pytest.mark.skipif("siconos" not in INSTALLED, reason="needs Debian's package python3-siconos")
def test_an_impact_near_the_limit_of_friction_converges_in_siconos():
    simulator = engines.adapter("siconos")
    coarse, fine = (outcome("compass-passive-a", simulator, dt, simulator.settings["best"]) for dt in (1e-3, 5e-4))
    assert fine.state_error == pytest.approx(0.5 * coarse.state_error, rel=0.4)
    assert fine.creep < 1e-7
    with pytest.raises(ProblemError, match="Siconos needs a moment of inertia, but stance_leg is a point mass"):
        outcome("torso-passive", simulator, 1e-3, simulator.settings["best"])


def test_a_crash_an_error_and_a_motion_that_diverges_are_results_of_their_time_step():
    (result,) = go.replay("compass-passive-stick", Crashing, time_steps=[2e-3, 5e-4, 1e-3], progress=False)
    assert [o.dt for o in result.outcomes] == [2e-3, 1e-3, 5e-4]
    assert [o.ending for o in result.outcomes] == ["no touchdown", "no touchdown", "crashed: SIGABRT"]
    assert result.order is None
    assert result.largest_dt is None
    assert outcome("compass-passive-stick", Failing, 2e-3, {}).ending == "failed: the contact solver does not converge"
    (result,) = go.replay("compass-passive-stick", Diverging, time_steps=[2e-3], progress=False)
    assert [o.ending for o in result.outcomes] == ["diverged"]
    assert result.to_record()["state_error"] == [None]


def test_a_call_ends_when_it_is_asked_to_and_a_folder_that_cannot_be_written_is_refused_first(tmp_path, monkeypatch):
    gait = go.solve("compass-passive-stick", progress=False, output=tmp_path / "run")
    with pytest.raises(KeyboardInterrupt):
        go.replay(gait, Hanging, time_steps=[2e-3], progress=False, should_stop=lambda: True)
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(StorageError, match=r"cannot write .*run is not writable"):
        go.replay(gait, Hanging, time_steps=[2e-3], progress=False, output=tmp_path / "run")


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
def test_the_process_of_an_engine_ends_with_its_parent_even_if_that_is_killed():
    program = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
import gaitopt as go
from crashing_engines import Hanging
go.replay("compass-passive-stick", Hanging, time_steps=[2e-3], progress=False)
"""
    with subprocess.Popen([sys.executable, "-c", program]) as parent:
        watched, children = psutil.Process(parent.pid), []
        while not children and parent.poll() is None:
            time.sleep(0.05)
            children = watched.children()
        parent.kill()
    assert len(children) == 1
    _, alive = psutil.wait_procs(children, timeout=LONG_ENOUGH)
    for child in alive:
        child.kill()
    assert not alive


def test_replays_are_kept_with_the_run_and_drawn_on_its_page(tmp_path):
    gait = go.solve("compass-passive-a", progress=False, output=tmp_path / "run")
    counted = []
    replays = go.replay(
        gait, Simulator, settings="default", time_steps=[4e-3], output=tmp_path / "run",
        progress=lambda done, total: counted.append((done, total)),
    )  # fmt: skip
    assert counted == [(1, 1)]
    assert stored_replays(tmp_path / "run") == json.loads(json.dumps([r.to_record() for r in replays]))
    assert main(["report", str(tmp_path / "run")]) == 0
    page = (tmp_path / "run" / "report.html").read_text()
    assert "in other physics engines" in page
    assert "in other physics engines" not in str(go.report(gait))


def test_engines_that_are_missing_or_cannot_be_imported_are_exit_code_2(capsys, monkeypatch):
    def failing(name):
        raise ImportError("compiled for another numpy\nand more lines")

    def refused(engine):
        assert main(["replay", "compass-passive-a", "--engine", engine]) == 2
        return capsys.readouterr().err

    monkeypatch.setattr(engines, "find_spec", lambda name: None)
    assert "--engine drake: is not installed; pip install 'gaitopt[engines]'" in refused("drake")
    assert "--engine siconos: is not installed; on Debian: apt install python3-siconos" in refused("siconos")
    monkeypatch.setattr(engines, "find_spec", find_spec)
    monkeypatch.setattr(engines, "ENGINES", {"mujoco": "numpy"})
    monkeypatch.setattr(engines, "import_module", failing)
    assert "--engine mujoco: cannot be imported: compiled for another numpy\n" in refused("mujoco")


def test_the_command_prints_an_object_per_setting_and_refuses_what_has_no_law(run, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(engines, "ENGINES", {"mujoco": "numpy"})
    monkeypatch.setattr(engines, "import_module", lambda name: sys.modules["numpy_engine"])
    words = ["replay", "compass-passive-stick", "--engine", "mujoco", "--dt", "0.004", "--setting", "default"]
    code, out, _ = run(*words, "-o", "kept", "--json")
    (line,) = out.splitlines()
    record = json.loads(line)
    assert code == 0
    assert {"problem", "engine", "version", "settings", "dt", "state_error", "order", "slip", "creep"} <= set(record)
    assert {"slip_missed", "slip_invented", "sequence_matches", "impact_error", "energy_error"} <= set(record)
    assert {"seconds_per_second", "largest_dt"} <= set(record)
    assert record["slip"].keys() == {"gait", "engine"}
    assert record["file"] == "kept/replay-numpy-engine.json"
    code, out, _ = run(*words, "-o", "kept")
    assert (code, "modes are right" in out) == (0, True)
    code, _, err = run("replay", "slip-run", "--engine", "mujoco", "--quiet")
    assert (code, "slip_runner has flight and massless feet; the engines cannot model that" in err) == (3, True)
    code, _, err = run(*words[:-1], "wild", "--quiet")
    assert code == 2
    assert "--setting 'wild': numpy-engine has no setting of this name; use default, best" in err


def test_settings_of_ones_own_and_wrong_time_steps():
    with pytest.raises(ProblemError, match="time_steps is empty, but must have at least one value"):
        go.replay("compass-passive-stick", Simulator, time_steps=[], progress=False)
    with pytest.raises(UnknownNameError, match="no such engine"):
        go.replay("compass-passive-stick", "bullet", progress=False)
    mine = {"mine": {"sweeps": 2}}
    (result,) = go.replay("compass-passive-stick", Simulator, settings=mine, time_steps=[4e-3, 4e-3], progress=False)
    assert (result.setting, result.settings) == ("mine", {"sweeps": 2})
    assert [outcome.dt for outcome in result.outcomes] == [4e-3]  # once
    assert result.order is None
