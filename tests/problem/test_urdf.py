"""Robots from URDF files: in problem files, in the library, in run folders and other processes; and what is refused."""

import json
import pickle
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robots import feet, tree, urdf

import gaitopt as go
from gaitopt.errors import ProblemError
from gaitopt.model.urdf import MAX_BYTES, walker_from_text
from gaitopt.problem.problem import restore_problem
from gaitopt.store.run import Run

RABBIT = Path(__file__).resolve().parents[2] / "docs" / "examples" / "rabbit.urdf"
FEET = ("stance_foot", "swing_foot")
TEXT = RABBIT.read_text(encoding="utf-8")
PROBLEM = """name: rabbit-file
walker: {urdf: robots/rabbit.urdf, feet: [stance_foot, swing_foot], slope: 2 deg}
friction: 0.6
gait:
  phases: [stick]
  impact: stick
  guess: {state: {torso: 0.05, stance_thigh: -0.35, stance_shin: -0.15, swing_thigh: 0.1,
    dtorso: 0, dstance_thigh: 1, dstance_shin: 1, dswing_thigh: 0, dswing_shin: 0}}
"""
TASK = """name: rabbit-task
walker: {urdf: robots/rabbit.urdf, feet: [stance_foot, swing_foot]}
friction: 0.6
control: {type: open_loop, intervals: 4}
gait: {phases: [stick], impact: stick, guess: {step_length: 0.4, duration: 0.5}}
objective: torque_squared
constraints: {speed: 0.8}
"""


@pytest.fixture
def problem_file(tmp_path: Path) -> Path:
    """The problem, with its robot in a folder beside it."""
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "rabbit.urdf").write_text(TEXT, encoding="utf-8")
    (tmp_path / "rabbit.yaml").write_text(PROBLEM, encoding="utf-8")
    return tmp_path / "rabbit.yaml"


def test_a_problem_file_names_a_robot_relative_to_itself(problem_file: Path) -> None:
    problem = go.load_problem(problem_file)
    assert problem.walker.shape == ("torso", "stance_thigh", "stance_shin", "swing_thigh", "swing_shin")
    assert problem.walker.actuators == ("stance_hip", "stance_knee", "swing_hip", "swing_knee")
    assert problem.parameters["walker.slope"] == pytest.approx(np.radians(2))
    walk = go.simulate(problem, steps=1)
    assert len(walk.trajectory.steps) == 1


def test_the_content_of_the_file_enters_the_hash(problem_file: Path) -> None:
    before = go.load_problem(problem_file)
    robot = problem_file.parent / "robots" / "rabbit.urdf"
    robot.write_text(TEXT.replace('mass value="12"', 'mass value="13"'), encoding="utf-8")
    after = go.load_problem(problem_file)
    assert before.digest != after.digest
    assert type(before.walker) is not type(after.walker)
    assert type(go.load_problem(problem_file).walker) is type(after.walker)


def test_a_robot_is_rebuilt_without_its_file(problem_file: Path, tmp_path: Path) -> None:
    problem = go.load_problem(problem_file)
    Run(tmp_path / "run").folder.mkdir()
    with Run(tmp_path / "run").begun(problem):
        pass
    (problem_file.parent / "robots" / "rabbit.urdf").unlink()
    restored = Run(tmp_path / "run").problem()
    assert restored.digest == problem.digest
    assert type(restored.walker) is type(problem.walker)
    assert (tmp_path / "run" / "robot.urdf").read_text(encoding="utf-8") == TEXT
    assert restore_problem(json.loads(json.dumps(problem.resolved()))).digest == problem.digest
    changed = restored.replace({"walker.slope": "1 deg", "friction": 0.5})
    assert type(changed.walker) is type(problem.walker)


def test_a_pickled_robot_is_rebuilt_from_its_content_in_another_process(problem_file: Path, tmp_path: Path) -> None:
    problem = go.load_problem(problem_file)
    assert pickle.loads(pickle.dumps(type(problem.walker))) is type(problem.walker)  # noqa: S301 - our own
    (tmp_path / "problem.pickle").write_bytes(pickle.dumps(problem))
    code = f"import pickle; print(pickle.load(open({str(tmp_path / 'problem.pickle')!r}, 'rb')).digest)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == problem.digest


def test_the_library_reads_a_robot_for_any_problem() -> None:
    robot = go.walker_from_urdf(RABBIT, feet=FEET)
    text = PROBLEM.replace("urdf: robots/rabbit.urdf, feet: [stance_foot, swing_foot]", f"model: {robot.model}")
    problem = go.parse_problem(text, walkers=[robot])
    assert type(problem.walker) is robot
    assert restore_problem(problem.resolved()).digest == problem.digest
    with pytest.raises(ProblemError, match=r"feet is \['stance_foot'\], but must name two links"):
        go.walker_from_urdf(RABBIT, feet=["stance_foot"])
    with pytest.raises(ProblemError, match=r"none\.urdf:1:1: no such file"):
        go.walker_from_urdf("none.urdf", feet=FEET)


def test_knees_bend_as_their_limits_allow_and_effort_zero_has_no_motor() -> None:
    backward = TEXT.replace('lower="0" upper="2.4"', 'lower="-2.4" upper="0"')
    posture = walker_from_text(backward, FEET, "backward.urdf").posture
    assert posture["swing_shin"] < posture["swing_thigh"]
    passive = TEXT.replace('upper="2.4" effort="150"', 'upper="2.4" effort="0"')
    assert walker_from_text(passive, FEET, "passive.urdf").actuators == ("stance_hip", "swing_hip")


def test_a_floating_base_and_an_empty_root_are_the_ground() -> None:
    root = (
        '<link name="world"/><link name="slide"/>'
        '<joint name="along" type="prismatic"><parent link="world"/><child link="slide"/><axis xyz="1 0 0"/></joint>'
        '<joint name="pitch" type="continuous"><parent link="slide"/><child link="torso"/><axis xyz="0 1 0"/></joint>'
        "</robot>"
    )
    grounded = walker_from_text(TEXT.replace("</robot>", root), FEET, "grounded.urdf")
    assert grounded.bodies == walker_from_text(TEXT, FEET, "rabbit.urdf").bodies


def test_arms_that_are_alike_change_places_when_the_feet_do() -> None:
    walker = walker_from_text(urdf(tree(9)), feet(9), "tree.urdf")
    q = {name: k for k, name in enumerate(walker.shape)}
    from casadi import Function

    from gaitopt.model.lagrangian import equations_of_motion

    eom = equations_of_motion(walker)
    swapped = np.asarray(Function("f", [eom.z], [eom.mechanism.relabel])([*range(9), *np.zeros(11)])).ravel()
    assert swapped[q["left_arm"]] == q["right_arm"]
    assert swapped[q["torso"]] == q["torso"]


SHIN = '<link name="swing_shin">'
LOOP = '<joint name="brace" type="fixed"><parent link="torso"/><child link="swing_shin"/></joint></robot>'
MESH = '<link name="swing_foot"><collision><geometry><mesh filename="foot.stl"/></geometry></collision></link>'
BOX = MESH.replace('<mesh filename="foot.stl"/>', '<box size="0.2 0.1 0.02"/>')
DOCTYPE = '<?xml version="1.0"?><!DOCTYPE robot [<!ENTITY a "aaaa">]>'


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('<axis xyz="0 1 0"/>', '<axis xyz="1 0 0"/>', r":\d+: joint stance_knee: is not planar: its axis \(1, 0,"),
        ('xyz="0 1 0"', 'xyz="0 0 1"', r"joint stance_hip: is not planar: .* are not horizontal \(z is up\)"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', r"joint stance_hip: has the axis \(0, 0, 0\), which is not a"),
        ("</robot>", LOOP, r"joint brace: closes a loop: link swing_shin is also the child of joint swing_knee"),
        ('child link="stance_thigh"', 'child link="torso"', r":5: link torso: closes a loop with its joints: only"),
        ("</robot>", '<link name="lost"/></robot>', r"link lost: is not one tree: links torso, lost belong to no"),
        ("</robot>", SHIN + "</link></robot>", r"link swing_shin: is defined twice, first in line \d+"),
        ('joint name="swing_knee"', 'joint name="torso"', r"joint torso: is also the name of the link in line \d+"),
        ('<child link="swing_shin"/>', '<child link="shin"/>', r"joint swing_knee: .* 'shin' of joint swing_knee is"),
        ('name="swing_knee" type="revolute"', 'name="swing_knee" type="prismatic"', "joint swing_knee: is prismatic:"),
        ('<mass value="3.2"/>', '<mass value="0"/>', r"link stance_shin: moves, but has no inertia"),
        ('<mass value="12"/>', '<mass value="-1"/>', r"link torso: has the mass -1 kg, which must not be negative"),
        ('<mass value="12"/>', "", r"link torso: has <inertial> without <mass>"),
        ('iyy="1.33"', 'iyy="-1"', r"link torso: has the moment of inertia -1 kg m\^2 about the axes"),
        ('<mass value="12"/>', '<mass value="\u0661"/>', r"link torso: <mass> value = '\u0661' is not a number"),
        ('<mass value="12"/>', '<mass value="nan"/>', r"link torso: <mass> value = 'nan' must be a number of at most"),
        ('<origin xyz="0 0 0.24"/>', '<origin xyz="0 0"/>', r"link torso: <origin> xyz = '0 0' must be three numbers"),
        ('<link name="swing_foot"/>', MESH, r"link swing_foot: is a foot, but its collision geometry is only a mesh"),
        ('<link name="swing_foot"/>', BOX, r"link swing_foot: is a foot, but its collision geometry is a box"),
        ('<?xml version="1.0"?>', DOCTYPE, r":1: a document type \(DTD\) is not allowed"),
        ('name="torso"', 'name="&a;"', r"urdf:5: is not XML: undefined entity"),
        ("</link>", "</lnk>", r"urdf:12: is not XML: mismatched tag"),
        ("</robot>", '<xacro:leg side="left"/></robot>', "is not XML|xacro is not expanded"),
        ('lower="0" upper="2.4"', 'lower="1" upper="0"', r"joint stance_knee: has the limits 1 and 0 rad, but lower"),
        ('effort="150"', 'effort="-150"', r"joint stance_hip: has the effort -150 N m, which must not be negative"),
        ('effort="150"', 'effort="99"', r"joint swing_hip: is unlike joint stance_hip: effort 99 and 150; both legs"),
        ('upper="2.4"', 'upper="2"', r"joint swing_knee: is unlike joint stance_knee: range \(0, 2\) and \(0, 2.4\);"),
        ("</joint>", '<dynamics damping="1"/></joint>', r"joint swing_hip: is unlike joint stance_hip: damping 1 and"),
        ('<limit lower="0" upper="2.4" effort="150" velocity="10"/>', "", "joint stance_knee: is revolute without"),
        ("</joint>", '<dynamics friction="0.1"/></joint>', "joint stance_hip: has dry friction, which is not modelled"),
        ("</joint>", '<dynamics damping="-1"/></joint>', "joint stance_hip: has the damping -1, which must not be neg"),
        ("</joint>", '<mimic joint="swing_hip"/></joint>', "joint stance_hip: mimics another joint"),
        ('<mass value="3.2"/>', '<mass value="3.3"/>', r"link swing_shin: is unlike link stance_shin: mass 3\.2 and"),
        ("swing_thigh", "swing-thigh", r"link swing-thigh: moves, and its name is a coordinate, which must have a"),
        ("swing_thigh", "dtorso", "link dtorso: moves, and has the name of a coordinate of the foot, or of a link's r"),
        ("swing_thigh", "mode", "link mode: moves, and has the name of another column of the table of a motion"),
        ("swing_knee", "f_n", "joint f_n: has a name with another meaning in problem files: rename it"),
        ("swing_knee", "swing.knee", r"joint swing.knee: moves, and its name is a motor's, which must have a name"),
    ],
)
def test_what_is_no_planar_robot_is_refused_with_file_line_and_name(old: str, new: str, words: str) -> None:
    assert old in TEXT
    count = 0 if old in ("swing_thigh", "swing_knee") or old == 'xyz="0 1 0"' else 1
    text = re.sub(re.escape(old), lambda _: new, TEXT, count=count)
    if "stance_knee" in words and old.startswith("<axis"):
        text = TEXT.replace(old, "<axis KEPT/>", 1).replace(old, new, 1).replace("<axis KEPT/>", old)
    with pytest.raises(ProblemError, match=words) as refusal:
        walker_from_text(text, FEET, "rabbit.urdf")
    assert re.match(r"rabbit\.urdf:\d+: ", str(refusal.value))
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("stance_foot", "swing_fot"), r"has no link 'swing_fot', which feet names; did you mean swing_foot\?"),
        (("stance_foot", "nothing"), r"has no link 'nothing', which feet names; links: torso, "),
        (("stance_foot", "stance_foot"), "link stance_foot: is named twice by feet: name two links"),
        (("stance_foot", "stance_shin"), "link stance_shin: and stance_foot are feet of one rigid body, stance_shin"),
        (("stance_foot", "swing_thigh"), "link swing_thigh: is unlike link stance_shin: mass 6.8 and 3.2; both legs"),
    ],
)
def test_feet_that_are_no_feet_are_refused(names: tuple[str, str], words: str) -> None:
    with pytest.raises(ProblemError, match=words):
        walker_from_text(TEXT, names, "rabbit.urdf")


def test_sizes_beyond_a_bound_are_refused() -> None:
    with pytest.raises(ProblemError, match=r"big\.urdf:1: is larger than 1024 kB"):
        walker_from_text(TEXT + " " * MAX_BYTES, FEET, "big.urdf")
    with pytest.raises(ProblemError, match="nested deeper than 20 levels"):
        walker_from_text(TEXT.replace("</robot>", "<a>" * 30 + "</a>" * 30 + "</robot>"), FEET, "deep.urdf")
    with pytest.raises(ProblemError, match="more than 5000 elements"):
        walker_from_text(TEXT.replace("</robot>", "<a/>" * 5000 + "</robot>"), FEET, "many.urdf")
    with pytest.raises(ProblemError, match="has 19 links that move; at most 16"):
        walker_from_text(urdf(tree(19)), feet(19), "long.urdf")


def test_errors_of_the_file_are_errors_of_the_problem_with_both_places(problem_file: Path, run: Any) -> None:
    assert run("validate", str(problem_file))[0] == 0
    robot, heavy = problem_file.parent / "robots" / "rabbit.urdf", TEXT.replace('value="12"', 'value="heavy"', 1)
    for content, reason in (
        (heavy.encode(), r"rabbit.urdf:8: link torso: <mass> value = 'heavy' is not a number"),
        (TEXT.encode() + b"\xff", r"\S+rabbit.urdf:\d+:1: byte 0xff is not UTF-8 text"),
        (None, ".*no such file"),
    ):
        robot.unlink() if content is None else robot.write_bytes(content)
        code, _, words = run("validate", str(problem_file))
        assert code == 3
        assert re.search(f"rabbit.yaml:2:10 walker.urdf: {reason}", words), words


@pytest.mark.parametrize(
    ("walker", "words"),
    [
        ("{urdf: 3, feet: [a, b]}", "walker.urdf: 3 is not a path of a URDF file"),
        ("{urdf: robots/rabbit.urdf}", "walker.feet: is missing"),
        ("{urdf: robots, feet: [a, b]}", "walker.urdf: .*robots:1:1: is not a file"),
        ("{urdf: robots/rabbit.urdf, model: rabbit, feet: [a, b]}", "walker.model: excludes urdf"),
        ("{urdf: robots/rabbit.urdf, feet: [stance_foot, swing_foot], mass: 3}", "walker.mass: unknown key"),
        (
            "{urdf: robots/rabbit.urdf, feet: [stance_foot, swing_foot, torso]}",
            "walker.feet: has 3 entries",
        ),
    ],
)
def test_wrong_keys_of_a_robot_are_refused(problem_file: Path, walker: str, words: str) -> None:
    lines: list[Any] = PROBLEM.splitlines()
    lines[1] = f"walker: {walker}"
    problem_file.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(ProblemError, match=words):
        go.load_problem(problem_file)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("4}", "4, bounds: {swing_hip: [5, 10]}}", "control.bounds.swing_hip: [5, 10] excludes zero, the first guess"),
        ("4}", "4, stance_hip: [0, 0, 0, 0, 151]}", "control.stance_hip[4]: 151 is outside of the bounds [-150, 150]"),
    ],
)
def test_a_task_that_a_robot_cannot_have_is_refused_in_a_sentence(
    problem_file: Path, old: str, new: str, words: str
) -> None:
    assert go.parse_problem(TASK, problem_file).constraints["angle.stance_knee"].maximum == 2.4
    with pytest.raises(ProblemError) as refusal:
        go.parse_problem(TASK.replace(old, new), problem_file)
    assert words in str(refusal.value)
    assert len(str(refusal.value).splitlines()) == 1


@pytest.mark.parametrize(
    "name", ["control", *(pytest.param(name, marks=pytest.mark.slow) for name in ("friction", "speed", "work"))]
)
def test_a_link_with_the_name_of_a_key_or_a_scalar_has_its_column_and_unit(tmp_path: Path, name: str) -> None:
    pytest.importorskip("pandas")
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "rabbit.urdf").write_text(TEXT.replace('"torso"', f'"{name}"'))
    problem = go.parse_problem(PROBLEM.replace("torso", name), tmp_path / "rabbit.yaml")
    frame = go.simulate(problem, steps=1).to_frame()
    assert frame.attrs["units"][name] == "rad"
    assert len({*frame.columns}) == len(frame.columns)
