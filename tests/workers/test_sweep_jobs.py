"""Jobs on real worker processes that are killed while they work."""

import os
import random
import signal
import threading
from collections import Counter

import psutil
import pytest
from worker_tasks import refuse, work

from gaitopt import load_problem
from gaitopt.errors import UnknownNameError
from gaitopt.runs.grid import Axis, Grid
from gaitopt.runs.jobs import SOLVED
from gaitopt.runs.sweep import TABLE_FILE, SweepPlan
from gaitopt.store.files import read_lines
from gaitopt.workers.cluster import ALLOWED_DEATHS, uninterrupted
from gaitopt.workers.jobs import FailedJob, Job, Workers, run_jobs

pytestmark = pytest.mark.skipif(os.name != "posix", reason="kills processes by signals")


def diary_entries(diary):
    return [tuple(map(int, line.split())) for line in diary.read_text().splitlines() if len(line.split()) == 2]


class Killer(threading.Thread):
    """Kills processes one after the other at random moments, chosen from those that are at work."""

    def __init__(self, at_work, victims, seed=1):
        super().__init__(daemon=True)
        self.at_work, self.victims, self.random = at_work, victims, random.Random(seed)
        self.killed = []
        self.over = threading.Event()

    def run(self):
        while len(self.killed) < self.victims and not self.over.wait(self.random.uniform(0.1, 0.4)):
            candidates = sorted(self.at_work() - set(self.killed))
            if candidates:
                self.killed.append(self.random.choice(candidates))
                os.kill(self.killed[-1], signal.SIGKILL)

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self.over.set()
        self.join()


def walk_through_kills(tmp_path, count, workers, victims):
    diary = tmp_path / "diary"
    jobs = [Job(key=f"job-{k}", argument=(k, str(diary), False)) for k in range(count)]

    def at_work():
        return {pid for _, pid in diary_entries(diary)[-20:]} if diary.exists() else set()

    with Killer(at_work, victims) as killer:
        results = list(run_jobs(work, jobs, Workers(count=workers)))
    return results, killer.killed, Counter(number for number, _ in diary_entries(diary))


@pytest.mark.parametrize(
    ("count", "workers", "victims"),
    [(150, 2, 2), pytest.param(1000, 10, 3, marks=pytest.mark.slow)],  # 3 of the 13 that there will have been
    ids=["small", "full"],
)
def test_every_job_is_done_and_none_twice_though_workers_are_killed(tmp_path, count, workers, victims):
    results, killed, begun = walk_through_kills(tmp_path, count, workers, victims)
    assert dict(results) == {f"job-{k}": k**2 for k in range(count)}
    assert len(results) == count
    assert len(killed) == victims
    assert sum(begun.values()) - count <= len(killed)  # a death costs the job at hand


@pytest.mark.slow
def test_table_of_a_sweep_is_the_same_though_workers_are_killed(tmp_path):
    """One of five workers, at a random moment."""
    frictions = Axis(key="friction", lower=0.34, upper=0.46, count=600)

    def sweep(folder):
        return SweepPlan(problem=load_problem("rimless-wheel-slip"), grid=Grid((frictions,)), warm=False, folder=folder)

    def at_work():
        lines = tmp_path / "killed" / SOLVED.name
        if not lines.exists() or lines.read_text().count("\n") <= 20:
            return set()
        # workers are spawned by this process, or forked by a server that it started; the server itself has children
        processes = [each for each in psutil.Process().children(recursive=True) if not each.children()]
        return {each.pid for each in processes if not any("resource_tracker" in word for word in each.cmdline())}

    undisturbed = sweep(tmp_path / "undisturbed")
    undisturbed.complete(Workers(count=2))
    killed = sweep(tmp_path / "killed")
    with Killer(at_work, victims=1) as killer:
        killed.complete(Workers(count=5))
    assert len(killer.killed) == 1
    assert (killed.run.path(TABLE_FILE)).read_text() == (undisturbed.run.path(TABLE_FILE)).read_text()
    keys = [record["job"] for record in read_lines(killed.folder / SOLVED.name)]
    assert sorted(keys) == sorted({job.key for job in killed.jobs})


@pytest.mark.parametrize("hears", ["this thread", "another"])
def test_interrupt_waits_while_workers_start(hears):
    """Ctrl-C inside the block is heard of after it; ``os.kill`` would leave open which thread hears of it, and when."""
    inside, handler = threading.Event(), signal.getsignal(signal.SIGINT)
    other = threading.Thread(target=lambda: inside.wait() and signal.raise_signal(signal.SIGINT))
    if hears == "another":
        other.start()  # before the block, in which threads start with the signal blocked
    seen = []

    def start():
        with uninterrupted():
            if hears == "another":
                inside.set()
                other.join()
            else:
                signal.raise_signal(signal.SIGINT)
            seen.append("the end of the block")

    with pytest.raises(KeyboardInterrupt):
        start()
    assert seen
    assert signal.getsignal(signal.SIGINT) is handler
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_job_that_kills_its_workers_is_set_aside_and_the_others_are_done(tmp_path):
    diary = tmp_path / "diary"
    jobs = [Job(key=f"job-{k}", argument=(k, str(diary), k == 3)) for k in range(8)]
    results = dict(run_jobs(work, jobs, Workers(count=2)))
    assert isinstance(results.pop("job-3"), FailedJob)
    assert results == {f"job-{k}": k**2 for k in range(8) if k != 3}
    assert Counter(number for number, _ in diary_entries(diary))[3] == ALLOWED_DEATHS + 1


def test_job_that_raises_is_set_aside_with_the_error(tmp_path):
    results = dict(run_jobs(refuse, [Job(key="a", argument=-1), Job(key="b", argument=-2)], Workers(count=2)))
    assert results["a"] == FailedJob(reason="ArithmeticError: no root of -1")


@pytest.mark.parametrize("workers", [1, 2])
def test_job_starts_from_the_result_of_its_parent(tmp_path, workers):
    diary = str(tmp_path / "diary")
    jobs = [Job(key=f"c{k}", argument=(k, diary, False), parent=f"c{k - 1}") for k in range(1, 5)]
    results = {"c0": 100}
    for key, result in run_jobs(work, iter(jobs), Workers(count=workers), results):
        results[key] = result
    assert results == {"c0": 100, "c1": 101, "c2": 105, "c3": 114, "c4": 130}


def test_stopped_jobs_keep_what_is_finished(tmp_path):
    finished = []
    jobs = [Job(key=str(k), argument=(k, str(tmp_path / "diary"), False)) for k in range(50)]
    for key, _ in run_jobs(work, jobs, Workers(count=2), should_stop=lambda: len(finished) >= 5):
        finished.append(key)
    assert 5 <= len(finished) < 50


def test_scheduler_that_does_not_answer_is_named(monkeypatch):
    monkeypatch.setattr("gaitopt.workers.cluster.CONNECT_TIMEOUT", 0.5)
    with pytest.raises(UnknownNameError, match=r"scheduler tcp://127.0.0.1:9 does not answer"):
        list(run_jobs(work, [Job(key="a", argument=None)], Workers(scheduler="tcp://127.0.0.1:9")))
