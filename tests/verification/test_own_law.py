"""A control law of one's own, end to end: it is a law like those of gaitopt."""

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from distributed import LocalCluster
from named import named, solved
from own_laws import DampedCompass, HipDamper

import gaitopt as go
from gaitopt.errors import StorageError

SOURCE = "compass-passive-a"


def damped_text(more: str = "") -> str:
    return f"{go.load_problem(SOURCE).text}\ncontrol: {{type: hip_damper, damping: 0.01}}\n{more}"


def damped(text: str) -> go.Problem:
    return go.parse_problem(text, controls=[HipDamper])


@pytest.fixture(scope="module")
def gait() -> go.Gait:
    return solved(damped(damped_text()))


def test_the_law_does_what_a_damper_of_the_walker_does_in_both_engines(gait: go.Gait) -> None:
    text = go.load_problem(SOURCE).text.replace("model: compass_biped", "model: damped_compass")
    other = solved(go.parse_problem(text, walkers=[DampedCompass]))
    np.testing.assert_allclose(gait.state, other.state, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.sort(np.abs(gait.multipliers)), np.sort(np.abs(other.multipliers)), rtol=1e-7)
    assert abs(gait.spectral_radius - named(SOURCE).spectral_radius) > 1e-4
    assert go.verify(gait).passed
    ends = [go.simulate(gait, steps=3, engine=engine).trajectory.section_states[-1] for engine in ("scipy", "heyoka")]
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-9, atol=1e-10)


def test_a_changed_parameter_is_followed_and_continued(gait: go.Gait) -> None:
    there = solved(gait.problem.replace({"control.damping": 0.02}))
    branch = go.continuation(gait, "control.damping", 0.02)
    assert branch.values[-1] == 0.02
    assert branch.column("period")[-1] == pytest.approx(there.period, rel=1e-9)


def test_a_design_finds_a_parameter_and_limits_can_be_free(gait: go.Gait) -> None:
    text = damped_text(f"constraints: {{speed: {float(gait.measures['speed'])!r}}}\n")
    text = text.replace("damping: 0.01", "damping: {free: [0, 0.1], guess: 0.02}")
    found = solved(damped(text))
    assert found.freed["control.damping"] == pytest.approx(0.01, rel=1e-6)
    text = damped_text("constraints: {speed: {min: 0.1}}\nobjective: torque_squared\n")
    text = text.replace("damping: 0.01", "damping: 0.01, limits: {hip: {free: [0.001, 1], guess: 0.5}}")
    problem = damped(text)
    assert problem.free["control.limits.hip"].guess == 0.5
    assert problem.parameters["control.limits.hip"] == 0.5
    assert problem.with_fixed({"control.limits.hip": 0.25}).parameters["control.limits.hip"] == 0.25


def test_pickles_name_the_class_and_a_run_is_loaded_with_it_or_refused_by_its_name(gait, tmp_path):
    again = pickle.loads(pickle.dumps(gait))  # noqa: S301 - our own
    assert again.problem.control == again.system.control == HipDamper(damping=0.01)
    assert type(again.problem.control) is HipDamper
    gait.save(tmp_path / "run")
    again = go.load_run(tmp_path / "run", controls=[HipDamper])
    assert again.problem == gait.problem
    assert again.multipliers == pytest.approx(gait.multipliers)
    with pytest.raises(StorageError, match="no control law is called 'hip_damper' here; the run needs the package"):
        go.load_run(tmp_path / "run")  # the class was that of one call


def test_figures_and_pages_show_the_gait(gait: go.Gait) -> None:
    drawn = [np.abs(np.asarray(line.get_ydata())).max() for line in go.plot(gait, "torques").lines]
    frame = gait.to_frame()
    braked = -0.01 * (frame["dtheta1"] + frame["dtheta2"])
    np.testing.assert_allclose(frame["hip"], braked, atol=1e-12)
    assert max(drawn) == pytest.approx(np.abs(braked).max(), rel=1e-2)
    assert gait.to_record()["control"] == {"damping": 0.01}
    assert "hip_damper" in go.report(gait).text


@pytest.mark.slow
def test_processes_and_dask_take_the_law_along(gait: go.Gait, tmp_path: Path) -> None:
    over = {"theta1": (-0.16, -0.14, 3), "dtheta1": (0.7, 0.75, 2)}
    serial = go.basin(gait, over, progress=False)
    parallel = go.basin(gait, over, workers=2, output=tmp_path / "basin", progress=False)
    assert repr(serial) == repr(parallel)
    values, folder = {"control.damping": (0.01, 0.012, 2)}, tmp_path / "sweep"
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        place = cluster.scheduler_address
        swept = go.sweep(gait.problem, values, scheduler=place, output=folder, progress=False)
    assert swept.column("period")[0] == pytest.approx(gait.period, rel=1e-9)


@pytest.mark.slow
def test_find_meets_the_gait(gait: go.Gait) -> None:
    found = go.find(gait.problem.replace({"gait.phases": "auto"}), starts=24, progress=False)
    assert any(abs(one.period - gait.period) < 1e-6 for one in found.gaits)


@pytest.mark.slow
def test_the_gait_is_proved(gait: go.Gait, tmp_path: Path) -> None:
    pytest.importorskip("flint")
    proof = go.prove(gait, output=tmp_path / "proof.json", progress=False)
    assert proof.proved, proof
    words = proof.statement["walker_data"]
    assert "HipDamper, no distribution" in words["control"]
    assert len(words["expressions_sha256"]) == 64
    refused = go.check_proof(tmp_path / "proof.json")
    assert not refused.proved
    assert "no control law is called 'hip_damper'" in refused.claims[0].finding
    assert go.check_proof(tmp_path / "proof.json", controls=[HipDamper]).proved


@pytest.mark.slow
def test_a_registered_law_goes_through_the_command_line(gait: go.Gait, tmp_path: Path) -> None:
    package = tmp_path / "own_laws-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: own-laws\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[gaitopt.controls]\nhip_damper = own_laws:HipDamper\n")
    file, run = tmp_path / "damped.yaml", tmp_path / "run"
    file.write_text(damped_text())
    here = [str(tmp_path), str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]

    def gaitopt(*words: str, plugin: bool = True) -> subprocess.CompletedProcess[str]:
        places = os.pathsep.join(here if plugin else here[1:])
        command = [sys.executable, "-m", "gaitopt", *words]
        env = {**os.environ, "PYTHONPATH": places}
        return subprocess.run(command, env=env, capture_output=True, text=True, check=False)

    ran = gaitopt("solve", str(file), "-o", str(run), "--json", "--quiet")
    assert ran.returncode == 0, ran.stderr
    assert json.loads(ran.stdout)["period"] == pytest.approx(gait.period, rel=1e-9)
    shown = gaitopt("show", str(file))
    assert "damping" in shown.stdout
    assert "N m s/rad" in shown.stdout
    assert "hip_damper" in gaitopt("schema").stdout
    missing = gaitopt("simulate", str(run), plugin=False)
    assert missing.returncode == 6
    assert "no control law is called 'hip_damper' here; the run needs the package that registers it" in missing.stderr
    assert "Traceback" not in missing.stderr
