"""Threads: what several threads solve, walk, prove or look up at once is what one thread gets, to the last bit."""

import random
import subprocess
import sys
import threading
import weakref
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import dask
import numpy as np
import pytest
from casadi import SX, Function
from named import named

import gaitopt
from gaitopt import Family, Mode, load_problem, prove, return_map, simulate, solve, verify
from gaitopt.building import BUILDING, BUILT, building, built_once
from gaitopt.cli.terminal import interruptible, listening
from gaitopt.errors import StorageError
from gaitopt.model.buffered import Buffers
from gaitopt.store.lock import only_writer
from gaitopt.threads import cached_property, per_thread
from gaitopt.workers.cluster import METHOD, connected

THREADS = 8
PROBLEMS = (
    "compass-passive-a", "compass-torque-stick", "compass-torque-slip", "compass-pd-impact-slip", "compass-push-off",
    "kneed-passive", "rimless-wheel-stick", "slip-run", "compass-minimum-friction",
)  # fmt: skip


@pytest.fixture(autouse=True)
def hasty():
    """Threads take turns so often that what they share is caught half-written."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(interval)


def in_threads(work, arguments):
    """The results of ``work`` in order, from up to eight threads that start at once."""
    jobs = list(arguments)
    count = min(THREADS, len(jobs))  # a pool starts no more threads than it has jobs
    start = threading.Barrier(count)
    with ThreadPoolExecutor(count, initializer=start.wait) as threads:
        return list(threads.map(work, jobs))


def digits(gait):
    """Every number of a gait, bit by bit."""
    assert gait.converged, gait.message
    arrays = [gait.shooting.times, gait.shooting.states, gait.shooting.errors, gait.multipliers, gait.p]
    arrays += [values for arc in gait.arcs for values in (arc.times, arc.states)]
    return [values.tobytes() for values in arrays], repr(gait.measures), repr(gait.freed)


def solved_digits(name):
    return digits(solve(load_problem(name), progress=False))


@pytest.mark.parametrize(
    ("names", "times"), [(PROBLEMS, 2), pytest.param(PROBLEMS, 125, marks=pytest.mark.slow)], ids=["18", "1125"]
)
def test_solves_of_eight_threads_equal_those_of_one_to_the_last_bit(names, times):
    jobs = list(names) * times
    random.Random(0).shuffle(jobs)
    solved = in_threads(solved_digits, jobs)
    expected = {name: solved_digits(name) for name in names}
    assert all(values == expected[name] for name, values in zip(jobs, solved, strict=True))


@pytest.mark.parametrize("engine", ["scipy", "heyoka"])
def test_walks_and_returns_of_several_threads_are_those_of_one(engine):
    if engine == "heyoka":
        pytest.importorskip("heyoka")

    def walked(name):
        gait = named(name)
        states = gait.state[gait.system.section(Mode.SLIP_FORWARD).indices] * np.linspace(1, 1.001, 20)[:, None]
        walk = simulate(gait, steps=3, engine=engine).trajectory.section_states
        return walk.tobytes(), return_map(gait, states, engine=engine).states.tobytes()

    names = ["compass-passive-a", "rimless-wheel-stick"] * 4
    assert in_threads(walked, names) == [walked(name) for name in names]


def test_verifications_and_proofs_of_several_threads_are_those_of_one():
    pytest.importorskip("flint")

    def proved(k):
        gait = named("rimless-wheel-stick")
        return repr(verify(gait).claims), repr(prove(gait, progress=False).to_record() if k % 4 == 0 else None)

    alone = [proved(0), proved(1)]
    assert in_threads(proved, range(THREADS)) == [alone[k % 4 > 0] for k in range(THREADS)]


def test_a_family_may_be_used_by_several_threads_in_turn():
    family = Family(named("compass-passive-a"))
    problems = [family.gait.problem.replace({"friction": 0.14 + 1e-4 * k}) for k in range(24)]
    for problem, gait in zip(problems, in_threads(family.solve, problems), strict=True):
        assert gait.converged
        assert np.allclose(gait.state, solve(problem, progress=False).state, rtol=1e-9, atol=1e-9)


def test_no_thread_uses_the_buffers_of_another(monkeypatch):
    made = Buffers.__init__

    def watched(buffers, *arguments, **options):
        made(buffers, *arguments, **options)
        evaluate, owner = buffers.evaluate, threading.get_ident()

        def evaluate_here():
            assert threading.get_ident() == owner, "buffers of another thread"
            evaluate()

        buffers.evaluate = evaluate_here

    monkeypatch.setattr(Buffers, "__init__", watched)
    problem = named("compass-passive-a").problem.replace({"friction": 0.1537})  # a value that nothing is kept for

    def worked(_):
        gait = solve(problem, progress=False)
        section = gait.state[gait.system.section(Mode.SLIP_FORWARD).indices]
        return_map(problem, section[None], engine="scipy")
        return verify(gait).passed and simulate(gait).complete_steps

    assert all(in_threads(worked, range(THREADS)))
    assert worked(0)


@pytest.mark.parametrize(
    "tasks",
    [
        ("run", "continue", "prove", "design"),
        *(
            pytest.param((task,), marks=pytest.mark.slow)
            for task in ("verify", "kneed", "pd", "design-friction", "design-pd", "picture", "search", "explain")
        ),
    ],
)
def test_expressions_and_functions_are_built_and_freed_under_the_lock_alone(tasks):
    for extra in ("heyoka", "flint"):
        pytest.importorskip(extra)
    program = Path(__file__).with_name("outside_the_lock.py")
    done = subprocess.run([sys.executable, program, *tasks], check=True, capture_output=True, text=True)
    assert done.stdout == ""


CONSTANTS = """
import threading, time
from casadi import SX
from gaitopt.building import building

end = time.monotonic() + 60

def work():
    x = SX.sym("x")
    scaled = building(lambda: 0.3 * x)  # dropped at once
    while time.monotonic() < end:
        scaled()

threads = [threading.Thread(target=work) for _ in range(4)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
"""


@pytest.mark.slow
def test_four_threads_build_and_free_a_constant_for_a_minute():
    """Without ``building``, every second run of 20 s ended in a segmentation fault."""
    subprocess.run([sys.executable, "-c", CONSTANTS], check=True)


def test_what_a_thread_drops_while_another_builds_is_freed_with_the_next_one():
    freed, function = [], building(lambda x: Function("f", [x], [x + 1]))(SX.sym("x"))
    weakref.finalize(function, freed.append, "dropped")
    deleted = BUILT._dropped
    with BUILDING, ThreadPoolExecutor(1) as other:
        holder = [function]
        del function
        other.submit(holder.clear).result()
        assert freed == ["dropped"]
        assert len(deleted) == 1
    building(SX.sym)("x")
    assert not deleted


def test_an_error_of_what_builds_keeps_no_expression():
    kept = []

    @building
    def failing():
        x = SX.sym("x")
        kept.append(weakref.ref(x))
        raise ValueError("no")

    def failed(_):
        with pytest.raises(ValueError, match="no"):
            failing()
        return kept[-1]() is None

    assert all(in_threads(failed, range(THREADS)))


def test_what_is_built_can_be_had_while_another_thread_builds():
    made = []

    @built_once(maxsize=4)
    def value(key):
        made.append(key)
        return [key]

    first = value("a")
    with BUILDING, ThreadPoolExecutor(1) as other:
        assert other.submit(value, "a").result(timeout=10) is first
    assert len({id(found) for found in in_threads(value, ["b"] * THREADS)}) == 1
    assert made == ["a", "b"]
    value.cache_clear()
    assert value("a") is not first


def test_a_property_takes_a_lock_that_another_thread_holds_while_it_enters_the_property():
    entered, lock = threading.Event(), threading.RLock()

    class Thing:
        @cached_property
        def value(self):
            entered.set()
            with lock:
                return object()

    def inside():
        return Thing().value

    with ThreadPoolExecutor(1) as other:
        with lock:
            waiting = other.submit(inside)
            assert entered.wait(10)
            assert Thing().value is not None
        assert waiting.result(timeout=10) is not None
    thing = Thing()
    assert len({id(value) for value in in_threads(lambda _: thing.value, range(THREADS))}) == 1
    assert Thing.value.attrname == "value"


def test_values_per_thread_are_kept_in_the_thread_and_made_anew_in_others():
    @per_thread(maxsize=4)
    def made(key):
        return [key]

    assert made("a") is made("a")
    others = in_threads(lambda _: made("a"), range(THREADS))
    assert all(other is not made("a") for other in others)


def test_equal_modes_are_one_object_in_all_threads():
    for k in range(50):
        modes = in_threads(Mode, [f"stick, thread{k} free"] * THREADS)
        assert len({id(mode) for mode in modes}) == 1


def test_signals_are_left_to_the_main_thread():
    def worked(_):
        with listening() as ending, interruptible() as pressed:
            return bool(ending), pressed()

    assert in_threads(worked, range(THREADS)) == [(False, False)] * THREADS


def test_one_thread_at_a_time_writes_a_folder(tmp_path):
    def refused(_):
        with pytest.raises(StorageError, match="is being written by"), only_writer(tmp_path):
            pytest.fail("two threads hold the folder")
        return True

    with only_writer(tmp_path), only_writer(tmp_path):
        assert all(in_threads(refused, range(THREADS)))
    with only_writer(tmp_path):
        pass


def test_workers_are_never_forked(monkeypatch):
    monkeypatch.setattr(gaitopt, "inherited", True, raising=False)
    with dask.config.set({METHOD: "fork"}), connected(1, None) as client:
        assert dask.config.get(METHOD) == "spawn"
        assert not client.submit(hasattr, gaitopt, "inherited").result()
    with dask.config.set({METHOD: "forkserver"}), connected(1, None):
        assert dask.config.get(METHOD) == "forkserver"
