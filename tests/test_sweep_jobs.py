"""Jobs on real worker processes that are killed while they work."""

import os
import random
import signal
import threading
import time
from collections import Counter
from pathlib import Path

import pytest

from gaitopt.errors import UnknownNameError
from gaitopt.study.jobs import ALLOWED_DEATHS, Job, SetAside, Workers, run_jobs

pytestmark = pytest.mark.skipif(os.name != "posix", reason="kills processes by signals")


def work(argument, parent):
    """Say who is at it, take a moment, and give the square; a deadly job kills its worker instead."""
    number, diary, deadly = argument
    with Path(diary).open("a", encoding="utf-8") as file:
        file.write(f"{number} {os.getpid()}\n")
    if deadly:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.01)
    return number**2 + (parent or 0)


def refuse(argument, parent):
    """Fail."""
    raise ArithmeticError(f"no root of {argument}")


def diary_entries(diary):
    return [tuple(map(int, line.split())) for line in diary.read_text().splitlines() if len(line.split()) == 2]


class Killer(threading.Thread):
    """Kills workers that have written in the diary, one after the other at random moments."""

    def __init__(self, diary, victims, seed=1):
        super().__init__(daemon=True)
        self.diary, self.victims, self.random = diary, victims, random.Random(seed)
        self.killed = []
        self.over = threading.Event()

    def run(self):
        while len(self.killed) < self.victims and not self.over.wait(self.random.uniform(0.1, 0.4)):
            alive = (
                {pid for _, pid in diary_entries(self.diary)[-20:]} - set(self.killed) if self.diary.exists() else ()
            )
            if alive:
                victim = self.random.choice(sorted(alive))
                self.killed.append(victim)
                os.kill(victim, signal.SIGKILL)


def walk_through_kills(tmp_path, count, workers, victims):
    diary = tmp_path / "diary"
    jobs = [Job(key=f"job-{k}", argument=(k, str(diary), False)) for k in range(count)]
    killer = Killer(diary, victims)
    killer.start()
    try:
        results = list(run_jobs(work, jobs, Workers(count=workers)))
    finally:
        killer.over.set()
        killer.join()
    return results, killer.killed, Counter(number for number, _ in diary_entries(diary))


@pytest.mark.parametrize(
    ("count", "victims"), [(150, 2), pytest.param(1000, 5, marks=pytest.mark.slow)], ids=["small", "full"]
)
def test_every_job_is_done_and_none_twice_though_workers_are_killed(tmp_path, count, victims):
    results, killed, begun = walk_through_kills(tmp_path, count, workers=2, victims=victims)
    assert dict(results) == {f"job-{k}": k**2 for k in range(count)}
    assert len(results) == count
    assert killed
    # a death costs the job at hand, and the one before it if its result was still on the way
    assert sum(begun.values()) - count <= 2 * len(killed)


def test_job_that_kills_its_workers_is_set_aside_and_the_others_are_done(tmp_path):
    diary = tmp_path / "diary"
    jobs = [Job(key=f"job-{k}", argument=(k, str(diary), k == 3)) for k in range(8)]
    results = dict(run_jobs(work, jobs, Workers(count=2)))
    assert isinstance(results.pop("job-3"), SetAside)
    assert results == {f"job-{k}": k**2 for k in range(8) if k != 3}
    assert Counter(number for number, _ in diary_entries(diary))[3] == ALLOWED_DEATHS + 1


def test_job_that_raises_is_set_aside_with_the_error(tmp_path):
    results = dict(run_jobs(refuse, [Job(key="a", argument=-1), Job(key="b", argument=-2)], Workers(count=2)))
    assert results["a"] == SetAside(reason="ArithmeticError: no root of -1")


@pytest.mark.parametrize("workers", [1, 2])
def test_job_starts_from_the_result_of_its_parent(tmp_path, workers):
    diary = str(tmp_path / "diary")
    jobs = [Job(key=f"c{k}", argument=(k, diary, False), parent=f"c{k - 1}") for k in range(1, 5)]
    results = dict(run_jobs(work, jobs, Workers(count=workers), done={"c0": 100}))
    assert results == {"c1": 101, "c2": 105, "c3": 114, "c4": 130}


def test_stopped_jobs_keep_what_is_finished(tmp_path):
    finished = []
    jobs = [Job(key=str(k), argument=(k, str(tmp_path / "diary"), False)) for k in range(50)]
    for key, _ in run_jobs(work, jobs, Workers(count=2), should_stop=lambda: len(finished) >= 5):
        finished.append(key)
    assert 5 <= len(finished) < 50


def test_scheduler_that_does_not_answer_is_named(monkeypatch):
    monkeypatch.setattr("gaitopt.study.jobs.CONNECT_TIMEOUT", 0.5)
    with pytest.raises(UnknownNameError, match=r"scheduler tcp://127.0.0.1:9 does not answer"):
        list(run_jobs(work, [Job(key="a", argument=None)], Workers(scheduler="tcp://127.0.0.1:9")))


def test_existing_scheduler_is_used(tmp_path):
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50) as cluster:
        jobs = [Job(key="a", argument=(6, str(tmp_path / "diary"), False))]
        assert dict(run_jobs(work, jobs, Workers(scheduler=cluster.scheduler_address))) == {"a": 36}
