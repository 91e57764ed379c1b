"""Workers of this machine belong to the user who started them, and their end costs no result."""

import logging
import multiprocessing
import multiprocessing.spawn
import os
import subprocess
import sys
import time
from pathlib import Path

import dask
import pytest
from distributed import Client, LocalCluster
from distributed.security import Security
from worker_tasks import slow_square, square

from gaitopt.errors import UnknownNameError
from gaitopt.workers import cluster
from gaitopt.workers.cluster import check_address, connected, script_not_repeated
from gaitopt.workers.jobs import Job, Workers, make_workers, run_jobs

NOBODY = 65534
TLS_KEYS = ("ca-file", "client.cert", "client.key")
INTRUDER = """
import os, socket, sys
from distributed import Client, LocalCluster
from distributed.security import Security
security = Security.temporary()
with LocalCluster(n_workers=1, processes=False, protocol="tls://", security=security, dashboard_address="127.0.0.1:0"
) as own, Client(own) as client:
    client.submit(os.getuid, pure=False).result()  # imports what it takes, which the other user may not be able to read
os.setgroups([]); os.setgid({uid}); os.setuid({uid})
place = sys.argv[1].partition("://")[2]
host, _, port = place.partition(":")
socket.create_connection((host, int(port)), timeout=5).close()
for scheme in ("tcp", "tls"):
    try:
        with Client(f"{{scheme}}://{{place}}", timeout=2, security=security if scheme == "tls" else None) as client:
            print("ran as", client.submit(os.getuid, pure=False).result(timeout=5))
            break
    except (OSError, TimeoutError) as error:
        print("refused", scheme, type(error).__name__)
"""


def intrusion(address):
    """What a process of another user achieves at the address of a scheduler."""
    program = [sys.executable, "-c", INTRUDER.format(uid=NOBODY), address]
    intruder = subprocess.run(program, cwd="/", capture_output=True, text=True, timeout=60)
    assert intruder.returncode == 0, intruder.stderr
    return intruder.stdout.splitlines()


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="only root can become another user")
def test_another_user_of_the_machine_cannot_run_code():
    with connected(1, None) as client:
        words = intrusion(client.scheduler.address)
    assert [line.split()[0] for line in words] == ["refused", "refused"]


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="only root can become another user")
def test_without_tls_the_same_intruder_runs_code():
    with LocalCluster(n_workers=1, dashboard_address="127.0.0.1:0", silence_logs=logging.CRITICAL) as plain:
        words = intrusion(plain.scheduler_address)
    assert words[0] == "ran as 0"


def test_sockets_of_the_workers_speak_tls_only_and_their_scratch_space_is_private_and_goes_with_them():
    with connected(1, None) as client:
        ((address, info),) = client.scheduler_info()["workers"].items()
        for each in (client.scheduler.address, address, info["nanny"]):
            assert each.startswith("tls://127.0.0.1:")
        worker = Path(info["local_directory"])
        scratch = next(folder for folder in worker.parents if folder.name.startswith("gaitopt-"))
        assert os.name != "posix" or scratch.stat().st_mode & 0o077 == 0
    assert not scratch.exists()


@pytest.mark.slow
def test_workers_that_are_not_seen_to_end_cost_no_result(monkeypatch):
    monkeypatch.setattr(cluster, "GRACE", 0.0)
    jobs = [Job(key=str(k), argument=k) for k in range(6)]
    before = set(multiprocessing.active_children())
    assert dict(run_jobs(slow_square, jobs, Workers(count=2))) == {str(k): k**2 for k in range(6)}
    until = time.monotonic() + 20
    while set(multiprocessing.active_children()) - before and time.monotonic() < until:
        time.sleep(0.05)
    assert not set(multiprocessing.active_children()) - before


def test_close_that_fails_costs_no_result(monkeypatch):
    real = {kind: kind.close for kind in (Client, LocalCluster)}

    def fails(kind):
        def close(self, *args, **settings):
            real[kind](self, *args, **settings)
            if "timeout" in settings:  # not where the garbage collector closes one
                raise TimeoutError

        return close

    for kind in real:
        monkeypatch.setattr(kind, "close", fails(kind))
    jobs = [Job(key=str(k), argument=k) for k in range(3)]
    assert dict(run_jobs(square, jobs, Workers(count=1, scheduler=None))) == {"0": 0, "1": 1, "2": 4}
    assert dict(run_jobs(square, jobs, Workers(count=2))) == {"0": 0, "1": 1, "2": 4}


def test_workers_do_not_start_the_script_of_their_caller_again(monkeypatch):
    main = sys.modules["__main__"]
    monkeypatch.setattr(main, "__file__", "script.py", raising=False)
    monkeypatch.setattr(main, "__spec__", None)
    assert "init_main_from_path" in multiprocessing.spawn.get_preparation_data("worker")
    with script_not_repeated():
        assert "init_main_from_path" not in multiprocessing.spawn.get_preparation_data("worker")
    assert main.__file__ == "script.py"


@pytest.mark.slow
def test_results_of_a_busy_machine_are_complete(tmp_path):
    """Twice as many busy loops as cores."""
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2 * (os.cpu_count() or 1))]
    try:
        jobs = [Job(key=str(k), argument=k) for k in range(20)]
        assert dict(run_jobs(slow_square, jobs, Workers(count=2))) == {str(k): k**2 for k in range(20)}
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


@pytest.mark.parametrize(
    "address", ["ucx://host:1", "tls://", "tcp://", "foo://x:2", "inproc://x", "host", "tcp://host:99999", ""]
)
def test_address_that_cannot_be_one_is_refused_before_anything_is_started(address):
    with pytest.raises(UnknownNameError, match="write tcp://HOST:PORT or tls://HOST:PORT"):
        make_workers(2, address)


def test_certificates_that_are_missing_or_bad_are_named(tmp_path):
    with pytest.raises(UnknownNameError, match=r"TLS needs certificates; set distributed.comm.tls.ca-file"):
        check_address("tls://127.0.0.1:8786")
    (tmp_path / "ca.pem").write_text("no certificate")
    with (
        dask.config.set({f"distributed.comm.tls.{key}": str(tmp_path / "ca.pem") for key in TLS_KEYS}),
        pytest.raises(UnknownNameError, match="bad certificates of TLS"),
    ):
        check_address("tls://127.0.0.1:8786")


def test_certificates_of_the_configuration_are_used_for_an_existing_scheduler(tmp_path):
    security = Security.temporary()
    texts = (security.tls_ca_file, security.tls_client_cert, security.tls_client_key)
    for key, text in zip(TLS_KEYS, texts, strict=True):
        (tmp_path / key).write_text(text)
    settings = {f"distributed.comm.tls.{key}": str(tmp_path / key) for key in TLS_KEYS}
    options = {"protocol": "tls://", "security": security, "silence_logs": logging.CRITICAL}
    with (
        LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0", **options) as scheduler,
        dask.config.set(settings),
    ):
        workers = make_workers(None, scheduler.scheduler_address)
        assert dict(run_jobs(square, [Job(key="a", argument=6)], workers)) == {"a": 36}
