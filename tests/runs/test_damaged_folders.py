"""A damaged run folder is named with its file and not changed: exit code 6, never an internal error, never a pass."""

import json
import random
import shutil
from pathlib import Path

import pytest

from gaitopt.cli.main import main
from gaitopt.store.run import Run

WHEEL = "rimless-wheel-slip"
SWEEP = ("sweep", WHEEL, "--over", "friction=0.40:0.42:2", "--workers", "1", "-o", "run")
BASIN = ("basin", WHEEL, "--over", "dtheta=0.8:1.0:4", "--engine", "scipy", "--workers", "1", "-o", "run")
BRANCH = ("continue", "run", "--param", "friction", "--to", "0.41", "-o", "branch")
READERS = {  # the commands that read a file, where the first says most
    "run/gait.json": (("verify", "run"), ("plot", "run", "--what", "multipliers"), ("report", "run"), BRANCH),
    "run/trajectory.csv": (("verify", "run"), ("solve", WHEEL, "--start", "run", "-o", "other")),
    "run/resolved.json": (("verify", "run"), ("simulate", "run")),
    "run/problem.yaml": (("verify", "run"),),
    "run/manifest.json": (("verify", "run"), SWEEP, BASIN),
    "run/jobs.jsonl": (SWEEP,),
    "run/SWEEP/sweep.json": (("plot", "run/SWEEP"),),
    "run/SWEEP/table.csv": (("plot", "run/SWEEP"),),
    "run/BASIN/basin.json": (("plot", "run/BASIN"),),
    "run/BASIN/tile-000000.npz": (("plot", "run/BASIN"),),
    "branch/branch.jsonl": (("plot", "branch"), ("report", "branch"), BRANCH),
    "branch/resolved.json": (("plot", "branch"),),
}


def digit(content, chance):
    places = [k for k, byte in enumerate(content) if chr(byte).isdigit()] or [len(content) // 2]
    k = chance.choice(places)
    return content[:k] + (b"1" if content[k : k + 1] != b"1" else b"2") + content[k + 1 :]


def rows(content, chance, change):
    lines = content.splitlines(keepends=True)
    change(lines, chance.randrange(max(len(lines) - 1, 1)))
    return b"".join(lines)


def swap(lines, k):
    if len(lines) > k + 1 and lines[k] != lines[k + 1]:
        lines[k], lines[k + 1] = lines[k + 1], lines[k]
    else:
        lines.append(b"\n")


def number(word):
    def change(content, chance):
        try:
            record = json.loads(content)
        except ValueError:
            return digit(content, chance)
        places = list(leaves(record))
        if not places:
            return content + b" "
        owner, key = chance.choice(places)
        if word is DROPPED:
            del owner[key]
        else:
            owner[key] = word
        return json.dumps(record).encode()

    return change


DROPPED = object()


def leaves(record):
    items = record.items() if isinstance(record, dict) else enumerate(record)
    for key, value in list(items):
        yield record, key
        if isinstance(value, dict | list):
            yield from leaves(value)


DAMAGES = {
    "digit": digit,
    "deleted row": lambda content, chance: rows(content, chance, lambda lines, k: lines.pop(k)),
    "swapped rows": lambda content, chance: rows(content, chance, swap),
    "nested": lambda content, chance: b"[" * 100_000,
    "empty object": lambda content, chance: b"{}\n",
    "empty": lambda content, chance: b"",
    "cut": lambda content, chance: content[: len(content) // 2],
    "random bytes": lambda content, chance: bytes(chance.randrange(256) for _ in range(300)),
    "null": number(None),
    "text": number("text"),
    "huge": number(10**12),
    "infinite": number(float("inf")),
    "list": number([]),
    "object": number({}),
    "missing key": number(DROPPED),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished run with a sweep, a basin and a branch."""
    place = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        for command in (("solve", WHEEL, "-o", "run"), SWEEP, BASIN, BRANCH):
            assert main([*command, "--quiet"]) == 0
    return place


@pytest.fixture
def copy(whole, tmp_path, monkeypatch):
    shutil.copytree(whole, tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    return tmp_path / "copy"


def placed(words):
    """The words of a command or a path with the names of the folders of sweep and basin."""
    own = {kind.upper(): next(Path("run").glob(f"{kind}-*")).name for kind in ("sweep", "basin")}
    return [word.replace("SWEEP", own["SWEEP"]).replace("BASIN", own["BASIN"]) for word in words]


def damage(name, kind, chance):
    (path,) = map(Path, placed([name]))
    before = path.read_bytes()
    path.write_bytes(DAMAGES[kind](before, chance))
    assert path.read_bytes() != before
    return path


def check_left_alone(run, path, command):
    before = path.read_bytes()
    code, out, err = run(*placed(command))
    assert code == 6, (command, code, err)
    assert path.name in err, err
    assert "passed" not in out
    assert path.read_bytes() == before


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("kind", ["digit", "deleted row", "empty", "nested"])
def test_damage_is_noticed_by_every_command_that_reads_the_file(copy, run, name, kind):
    path = damage(name, kind, random.Random(1))
    for command in READERS[name]:
        check_left_alone(run, path, command)


@pytest.mark.parametrize("kind", [kind for kind in DAMAGES if kind not in ("digit", "deleted row", "empty", "nested")])
def test_damage_of_any_kind_is_noticed(copy, run, kind):
    for seed, name in enumerate(READERS):
        (path,) = map(Path, placed([name]))
        content = path.read_bytes()
        damage(name, kind, random.Random(seed))
        check_left_alone(run, path, READERS[name][0])
        path.write_bytes(content)


def test_checksums_are_of_every_file_that_is_read(copy):
    for name in READERS:
        path = Path(*placed([name]))
        if path.name != "manifest.json":
            assert path.relative_to(path.parts[0]).as_posix() in Run(Path(path.parts[0])).manifest().files


def test_manifest_that_lost_a_file_says_unfinished(copy, run):
    (Path("run") / "gait.json").unlink()
    code, _, err = run("verify", "run")
    assert (code, "unfinished" in err) == (6, True)
