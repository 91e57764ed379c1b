"""Pickles and copies: results reach other processes as they are, and compute there what they would compute here."""

import copy
import multiprocessing
import os
import pickle
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest
from named import named

import gaitopt as go
from gaitopt import Mode, load_problem, simulate, solve, verify
from gaitopt.model.walkers.rimless_wheel import RimlessWheel
from gaitopt.search.find import gaits_of
from gaitopt.workers.cluster import connected


def sent(value, dumps=pickle.dumps):
    """What arrives of a value."""
    return pickle.loads(dumps(value))  # noqa: S301 - our own


WAYS = {"pickle": sent, "copy": copy.copy, "deepcopy": copy.deepcopy}
WHEEL = "rimless-wheel-stick"


def content(value):
    """Everything that a result holds, its arrays to the last bit, without the compiled functions."""
    if isinstance(value, np.ndarray):
        return value.shape, value.flags.writeable, value.tobytes()
    if is_dataclass(value):
        return type(value), [content(getattr(value, field.name)) for field in fields(value)]
    if isinstance(value, dict):
        return {key: content(item) for key, item in value.items()}
    if isinstance(value, list | tuple) and not isinstance(value, str):
        return [content(item) for item in value]
    parts = getattr(value, "parameters", None)
    return (type(value), parts) if parts is not None else repr(value)


def results():
    wheel, gait = named(WHEEL), named("compass-passive-a")
    section = gait.state[gait.system.section(Mode.SLIP_FORWARD).indices]
    branch = go.continuation(wheel, "friction", to=0.9, max_points=3, progress=False)
    candidate = {**wheel.to_record(), "steps": [wheel.to_record()], "start": "test"}
    return {
        "problem": load_problem("compass-pd-impact-slip"),
        "gait": gait,
        "tracking gait": named("compass-pd-impact-slip"),
        "two steps": named("compass-unequal"),
        "failed gait": solve(gait.problem.replace({"walker.slope": "-1 deg"}), progress=False),
        "design": named("compass-minimum-friction"),
        "walk": simulate(gait, steps=2),
        "trajectory": simulate(gait, steps=2).trajectory,
        "verification": verify(wheel),
        "branch": branch,
        "point": branch[0],
        "special point": branch.specials[0],
        "returns": go.return_map(gait, section[None]),
        "explanation": go.explain(wheel.problem.replace({"friction": 0.8}), seconds=0, progress=False),
        "gaits": gaits_of(
            wheel.problem.replace({"gait.phases": "auto"}),
            [{"method": "simulation", "starts": 1, "candidates": [candidate]}],
        ),
    }


def test_every_result_survives_copies_and_pickles_to_the_last_bit():
    for name, result in results().items():
        for way, copied in WAYS.items():
            again = copied(result)
            assert type(again) is type(result), (name, way)
            assert repr(again) == repr(result), (name, way)
            assert content(again) == content(result), (name, way)


@pytest.mark.slow
def test_results_of_run_folders_survive_pickles_and_folders_hold_none(empty_folder):
    problem = named(WHEEL).problem
    kept = [
        go.sweep(problem, {"friction": (0.93, 0.95, 2)}, workers=1, progress=False),
        go.basin(named(WHEEL), {"dtheta": (0.7, 0.8, 2)}, steps=5, engine="scipy", workers=1, progress=False),
        go.multistart(problem, 2, workers=1, progress=False, output=empty_folder / "starts"),
    ]
    named(WHEEL).save(empty_folder / "gait")
    assert repr(sent(kept)) == repr(kept)
    files = [path for path in empty_folder.rglob("*") if path.is_file()]
    assert len(files) > 5
    assert not [path for path in files if path.read_bytes()[:1] == b"\x80"]


def test_proofs_survive_pickles_ball_by_ball():
    pytest.importorskip("flint")
    from flint import arb, ctx  # an extra

    from gaitopt.proof.arithmetic import decimal_bounds

    proof = go.prove(named(WHEEL), progress=False)
    again = sent(proof)
    assert again.to_record() == proof.to_record()
    with ctx.workprec(300):
        balls = [arb(1) / 3, arb(2, 1e-5) / 7, arb(2).exp(), arb(0), arb(1, 0.25), arb(-1, 2**-30), *again.durations]
    for ball in balls:
        same = sent(ball)
        assert (same.mid().man_exp(), same.rad().man_exp()) == (ball.mid().man_exp(), ball.rad().man_exp())
        assert decimal_bounds(same) == decimal_bounds(ball)
    assert not sent(arb("nan")).is_finite()


def test_modes_are_the_same_objects_and_equal_systems_are_unpickled_once():
    mode = Mode("stick, knee free")
    assert all(way(mode) is mode for way in WAYS.values())
    gait = named("compass-pd-impact-slip")
    first, second = (sent(gait) for _ in range(2))
    assert first.system is second.system
    assert sent(named("compass-passive-a")).system is not first.system
    assert copy.deepcopy(gait).system is gait.system


@pytest.mark.parametrize("way", WAYS)
def test_a_copied_family_goes_on_from_the_same_solutions(way):
    family = go.Family(named("compass-passive-a"))
    problems = [family.gait.problem.replace({"friction": 0.14 + 1e-3 * k}) for k in range(4)]
    for problem in problems[:-1]:
        family.solve(problem)
    again = WAYS[way](family)
    assert content(again.solve(problems[-1]).steps) == content(family.solve(problems[-1]).steps)


def pool(kind):
    """An executor with one process, of the standard library or of Dask."""
    return connected(1, None) if kind == "dask" else ProcessPoolExecutor(1, multiprocessing.get_context("spawn"))


@pytest.mark.parametrize("kind", ["process pool", pytest.param("dask", marks=pytest.mark.slow)])
def test_other_processes_compute_with_what_they_are_sent(kind):
    gait = named("compass-pd-impact-slip")
    with pool(kind) as processes:
        again = processes.submit(solve, gait.problem, progress=False).result()
        walk = processes.submit(simulate, gait, steps=2).result()
        verification = processes.submit(verify, gait).result()
    assert content(again.steps) == content(gait.steps)
    assert content(walk.trajectory) == content(simulate(gait, steps=2).trajectory)
    assert repr(verification) == repr(verify(gait))


PLUGIN = """
from gaitopt.model.walkers.rimless_wheel import RimlessWheel

class HomeMadeWheel(RimlessWheel):
    model = "home_made"
"""
LOAD = "import pickle, sys; print([each.walker for each in pickle.load(sys.stdin.buffer)])"


def test_walkers_of_modules_are_imported_where_they_arrive(tmp_path, monkeypatch):
    (tmp_path / "home_made.py").write_text(PLUGIN)
    monkeypatch.syspath_prepend(str(tmp_path))
    import home_made

    problem = load_problem(_wheel_file(tmp_path), walkers=[home_made.HomeMadeWheel])
    message = pickle.dumps([problem, solve(problem, progress=False).problem])
    assert _loaded_elsewhere(message, str(tmp_path)).stdout.count(b"HomeMadeWheel(") == 2
    refused = _loaded_elsewhere(message, "").stderr.decode()
    assert "UnknownNameError: walker home_made: its class HomeMadeWheel cannot be imported" in refused
    assert "install the package of the walker there" in refused


def test_a_walker_that_no_module_holds_is_refused_with_a_sentence_but_dask_sends_it_by_value(tmp_path):
    class Local(RimlessWheel):
        model = "home_made"

    problem = load_problem(_wheel_file(tmp_path), walkers=[Local])
    with pytest.raises(pickle.PicklingError, match=r"another process cannot import its class .*Local.*; define"):
        pickle.dumps(problem)
    assert copy.deepcopy(problem) == problem
    cloudpickle, gait = pytest.importorskip("cloudpickle"), solve(problem, progress=False)
    assert content(sent(gait, cloudpickle.dumps).steps) == content(gait.steps)


def _wheel_file(folder):
    path = folder / "wheel.yaml"
    path.write_text(named(WHEEL).problem.text.replace("model: rimless_wheel", "model: home_made"))
    return path


def _loaded_elsewhere(message, path):
    places = os.pathsep.join([path, str(Path(__file__).parents[1])])
    environment = {**os.environ, "PYTHONPATH": places}
    return subprocess.run(
        [sys.executable, "-c", LOAD], input=message, capture_output=True, env=environment, check=False
    )
