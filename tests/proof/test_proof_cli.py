"""``gaitopt prove``: exit codes, its JSON, and certificates on disk."""

import json
import os
import shutil
import subprocess
import sys
from contextlib import redirect_stdout
from decimal import Decimal
from pathlib import Path

import pytest

from gaitopt.cli.main import main

KEYS = {"problem", "proved", "state", "durations", "period", "multipliers", "spectral_radius", "stable", "claims"}


@pytest.fixture(scope="module")
def proved(tmp_path_factory):
    """The folder in which a proof was printed and kept."""
    place = tmp_path_factory.mktemp("proved")
    with pytest.MonkeyPatch.context() as patch, (place / "printed.json").open("w") as file, redirect_stdout(file):
        patch.chdir(place)
        assert main(["prove", "rimless-wheel-stick", "--json", "--quiet"]) == 0
    return place


@pytest.fixture
def certificate(proved, tmp_path, monkeypatch):
    monkeypatch.chdir(shutil.copytree(proved, tmp_path / "proved"))
    return json.loads(Path("printed.json").read_text())


def test_what_proofs_do_not_cover_is_said_without_empty_tables(run, empty_folder):
    code, out, _ = run("prove", "slip-walk", "--quiet")
    assert code == 4
    assert "a slip_walker has massless contacts with coordinates of their own" in out
    assert "hypothesis" not in out
    assert "bounds" not in out


def test_what_is_no_certificate_is_exit_6_and_one_of_another_format_is_named_and_exit_4(run, empty_folder):
    for content in ("no json", "[]", '{"schema": "gaitopt-proof-6"}'):
        Path("proof.json").write_text(content)
        code, _, err = run("prove", "--check", "proof.json")
        assert code == 6, content
        assert "proof.json is not a proof certificate" in err
    for schema in ("gaitopt-proof-4", "gaitopt-proof-5"):
        Path("proof.json").write_text(json.dumps({"schema": schema}))
        code, out, _ = run("prove", "--check", "proof.json", "--json", "--quiet")
        assert code == 4, schema
        assert schema in json.loads(out)["claims"][0]["words"]


def test_a_proof_is_printed_kept_and_checked_again(run, certificate):
    assert certificate.keys() >= KEYS
    assert certificate["proved"]
    assert certificate["stable"]
    lower, upper = map(Decimal, certificate["state"]["dtheta"])
    assert 0 < upper - lower < Decimal("1e-12")
    assert lower < Decimal("0.7586652628707168594913327") < upper
    file = certificate["certificate"]
    code, out, _ = run("prove", "--check", file, "--json", "--quiet")
    assert code == 0
    assert json.loads(out) == certificate
    code, out, _ = run("prove", "--check", file)
    assert code == 0
    assert "rimless-wheel-stick: proved, stable" in out


def test_a_certificate_that_proves_nothing_is_exit_4(run, certificate):
    file = Path(certificate["certificate"])
    record = json.loads(file.read_text())
    record["boxes"][0]["centre"][0] = "0.7587"
    file.write_text(json.dumps(record))
    code, out, _ = run("prove", "--check", str(file), "--json")
    assert code == 4
    assert not json.loads(out)["proved"]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ("--check /dev/zero", 6, "not a regular file"),
        ("--check .", 6, "not a regular file"),
        ("--check nothing.json", 6, "is missing"),
        ("--check proof.json --set friction=0.2", 2, "--check"),
        ("nothing@special.0", 6, "nothing contains no branch"),
        ("nothing@special.0 --set friction=0.2", 2, ""),
        ("rimless-wheel-stick --width 1e-6", 2, ""),
        *((f"nothing@special.0 --width={w}", 2, "--width") for w in ("0", "-1", "inf", "nan", "1e300", "1e-300")),
    ],
)
def test_what_cannot_be_proved_or_checked_is_named(run, empty_folder, arguments, code, words):
    ended, _, err = run("prove", *arguments.split())
    assert ended == code
    assert words in err


def test_a_missing_library_is_named():
    program = (
        "import sys; sys.modules['flint'] = None; from gaitopt.cli.main import main; "
        "sys.exit(main(['prove', 'rimless-wheel-stick']))"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert "pip install 'gaitopt[proof]'" in ended.stderr


def test_a_parameter_may_be_an_interval(run, empty_folder):
    code, out, _ = run("prove", "rimless-wheel-stick", "--set", "friction=0.95..1", "--json", "--quiet")
    assert code == 0
    record = json.loads(Path(json.loads(out)["certificate"]).read_text())
    assert record["intervals"] == {"friction": "0.95..1"}
    assert json.loads(out)["statement"]["parameters"]["friction"] == "0.95..1"
    code, _, err = run("prove", "rimless-wheel-stick", "--set", "friction=0.95..much")
    assert code == 3
    assert "--set friction" in err


@pytest.mark.slow
def test_an_interval_of_angles_has_one_unit_and_is_printed_with_it(run, empty_folder):
    code, out, _ = run("prove", "rimless-wheel-stick", "--set", "walker.slope=13 deg..13.0001 deg", "--quiet")
    assert code == 0
    assert ["walker.slope", "13.00005", "±", "5e-05", "deg"] in [line.split() for line in out.splitlines()]
    code, _, err = run("prove", "rimless-wheel-stick", "--set", "walker.slope=13 deg..0.227 rad")
    assert code == 3
    assert "--set walker.slope: '13 deg..0.227 rad': state both ends in the same unit" in err


def test_a_folder_that_cannot_be_written_is_refused_before_the_proof(run, certificate, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr("gaitopt.proof.prove.prove", None)
    code, _, err = run("prove", str(Path(certificate["certificate"]).parent), "--quiet")
    assert code == 6
    assert "proof.json" in err
    assert "is not writable; choose another place with -o" in err


@pytest.mark.slow
def test_a_special_point_of_a_branch_is_proved(run, empty_folder):
    run("continue", "rimless-wheel-stick", "--param", "friction", "--to", "0.9", "-o", "branch", "--quiet")
    code, out, _ = run("prove", "branch@special.0", "--json", "--quiet")
    assert code == 0
    record = json.loads(out)
    assert record["proved"]
    assert (record["parameter"], record["special"]) == ("friction", "mode_change")
    lower, upper = map(Decimal, record["interval"].split(".."))
    assert lower < Decimal("0.914120784") < upper
    assert upper - lower == Decimal("1e-8")
    code, _, _ = run("prove", "--check", record["certificate"])
    assert code == 0
    code, _, err = run("prove", "branch@special.1")
    assert code == 2
    assert "is of type end" in err
    for number in ("7", 5000 * "9", "\u0663"):
        code, _, err = run("prove", f"branch@special.{number}")
        assert code == 2
        assert f"has no special point '{number[:9]}" in err
