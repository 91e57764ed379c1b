"""The set of reference orbits: what its files state is complete, right, and enough to recompute the orbits."""

import hashlib
import json
import re
import runpy
import sys
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import casadi as ca
import numpy as np
import pytest
from orbit_files import PROGRAM, SET, changed, differing
from samples import sampled

import gaitopt as go
from gaitopt.problem.writing import ExactValues, write_problem
from gaitopt.show.orbits import OPERATIONS, formulas, orbit_record

ROOT = Path(__file__).parents[2]
judge = PROGRAM["judge"]


@cache
def text(name: str) -> str:
    return (SET / f"{name}.json").read_text()


def orbit(name: str) -> dict[str, Any]:
    return json.loads(text(name))


def all_names() -> list[str]:
    return sorted(path.stem for path in SET.glob("*.json") if path.stem != "schema")


QUICK = ("compass-passive-a", "compass-unequal", "compass-pd-designed", "kneed-passive", "slip-run-foot")


@pytest.mark.portable
@pytest.mark.parametrize("name", QUICK)
def test_an_orbit_is_recomputed_from_its_file_by_a_program_without_gaitopt(name):
    source = (SET / "recompute.py").read_text()
    assert "import gaitopt" not in source
    assert "from gaitopt" not in source
    assert differing(orbit(name)) == []


@pytest.mark.parametrize("name", sampled(sorted({*all_names()} - {*QUICK}), every=6))
def test_every_orbit_is_recomputed(name):
    assert differing(orbit(name)) == []


A = "compass-passive-a"
SLIPPERY = {"value": 0.001, "exact": "0.001", "key": "friction", "unit": ""}


@pytest.mark.parametrize(
    ("name", "place", "change", "group"),
    [
        (A, "statement/parameters/leg_mass/value", lambda mass: mass * (1 + 1e-12), "parameters"),
        (A, "orbit/events/1/time", lambda time: time + 1e-7, "ends of phases"),
        (A, "statement/equations/h/0", lambda text: f"{text} + 1", "equations"),
        (A, "orbit/samples/rows/3/9", lambda force: 2 * force, "samples"),
        (A, "orbit/scalars/speed/value", lambda speed: speed * 1.0001, "scalars"),
        (A, "orbit/phases/0/duration/enclosure", lambda _: ["1", "2"], "enclosures"),
        ("compass-passive-stick", "statement/parameters/friction", lambda _: SLIPPERY, "margins"),
        ("rimless-wheel-slip", "orbit/stable", lambda stable: not stable, "multipliers"),
        ("rimless-wheel-slip", "orbit/events", lambda events: events[:-1], "events"),
        ("hopper", "orbit/initial_state/dshortening/value", lambda rate: rate + 1e-4, "initial state"),
        ("crawler", "statement/contacts/front/velocity/0", lambda text: f"-({text})", "margins"),
        ("heel-toe", "orbit/events/0/impulse/F_n.toe", lambda impulse: 1.001 * impulse, "events"),  # within the step
        *(pytest.param(*case, marks=pytest.mark.slow) for case in (
            (A, "orbit/initial_state/dtheta1/value", lambda rate: rate + 1e-4, "initial state"),
            (A, "orbit/period/value", lambda period: period + 1e-7, "period"),
            (A, "orbit/events/2/impulse/F_t", lambda impulse: -impulse, "events"),
            (A, "orbit/multipliers", lambda _: [], "multipliers"),
            ("slip-run", "statement/parameters/friction", lambda _: SLIPPERY, "margins"),
            ("compass-unequal", "orbit/multipliers", lambda multipliers: multipliers[:-1], "multipliers"),
            ("compass-passive-b", "orbit/multipliers", lambda multipliers: multipliers[:-1], "multipliers"),  # zero
            ("kneed-passive", "orbit/events/0/what", lambda _: "touchdown", "events"),
            ("compass-pd-designed", "evaluation/arcs/1/end", lambda end: end + 1e-6, "samples"),
            ("compass-virtual-constraint", "orbit/samples/rows/5/11", lambda torque: 1.001 * torque, "samples"),
            ("crawler", "statement/friction/rear/static", lambda _: "0.5", "margins"),
            ("crawler", "orbit/samples/rows/3/10", lambda force: 1.001 * force, "samples"),
            ("crawler", "orbit/multipliers", lambda multipliers: multipliers[:-1], "multipliers"),
            ("heel-toe", "orbit/events/1/impulse/F_n.swing_heel", lambda impulse: 1.001 * impulse, "events"),
            ("heel-toe", "statement/contacts/toe/gap", lambda text: f"{text} - 0.001", "margins"),
            ("kneed-passive", "orbit/events/0/impulse/F_n", lambda impulse: 1.001 * impulse, "events"),  # of the stop
            ("kneed-passive", "statement/equations/h/1", lambda text: f"{text} + 1", "equations"),
            ("compass-push-off", "statement/further_parts/push/foot/1", lambda text: f"1.001*({text})", "equations"),
            ("crawler", "statement/cycle_end/period", lambda period: 1.001 * period, "ends of phases"),
            ("bounding", "statement/cycle_end/margin", lambda text: f"{text} - 0.001", "margins"),
            ("bounding", "statement/contacts/front/places/front_x", lambda text: f"1.001*({text})", "margins"),
            ("bounding", "statement/further_parts/springs/back/3", lambda text: f"1.001*({text})", "samples"),
            ("bounding", "orbit/multipliers", lambda multipliers: multipliers[:-1], "multipliers"),
            ("slip-walk-stable", "evaluation/arcs/1/swaps", lambda _: False, "ends of phases"),
        )),
    ],
)  # fmt: skip
def test_what_is_wrong_in_an_orbit_is_found(name, place, change, group):
    assert group in differing(changed(orbit(name), place, change))


def test_an_orbit_that_meets_an_event_with_the_wrong_friction_has_none_there():
    with pytest.raises(ValueError, match=r"slip_velocity does not fall to zero at 0\.0893599656 s in slip_forward"):
        judge(changed(orbit("compass-passive-a"), "statement/parameters/friction", lambda _: SLIPPERY))


def test_the_exit_code_of_the_program_is_its_judgement(tmp_path, monkeypatch, capsys):
    wrong = tmp_path / "wrong.json"
    spoiled = changed(orbit("rimless-wheel-slip"), "orbit/initial_state/dtheta/value", lambda rate: rate + 1e-4)
    wrong.write_text(json.dumps(spoiled))
    (tmp_path / "empty.json").write_text("{}")

    def run(*files: Path) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["recompute.py", *map(str, files)])
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(SET / "recompute.py"), run_name="__main__")
        code = ended.value.code
        return (1 if isinstance(code, str) else code), capsys.readouterr().out

    right = SET / "rimless-wheel-slip.json"
    code, out = run(right)
    assert (code, out.splitlines()[0]) == (0, f"{right}: agrees")
    code, out = run(wrong, right)
    assert code == 1
    assert f"{wrong}: DIFFERS in ends of phases, period, initial state" in out
    assert f"{right}: agrees" in out
    assert run(tmp_path / "empty.json")[0] == 1
    assert run(tmp_path / "missing.json")[0] == 1
    assert run()[0] == 1  # no file


def values(data: dict[str, Any], names: dict[str, Any], texts: dict[str, Any]) -> dict[str, Any]:
    """Some expressions of a statement at given values of its names."""
    known = {name: getattr(np, name) for name in ("sin", "cos", "tan", "tanh", "sqrt", "exp")} | {"atan2": np.arctan2}
    known |= {name: entry["value"] for name, entry in data["statement"]["parameters"].items()} | names | {"y": 0.0}
    for name, text in data["statement"]["definitions"]:
        known[name] = eval(text, known)  # noqa: S307 - the file is our own

    def number(text: Any) -> Any:
        return [number(entry) for entry in text] if isinstance(text, list) else eval(text, known)  # noqa: S307

    return {name: np.array(number(text), dtype=float) for name, text in texts.items()}


@pytest.mark.parametrize("name", ["compass-passive-a", "compass-torque-slip", "rimless-wheel-slip", "torso-upright"])
def test_the_solved_equations_are_those_of_the_statement(name):
    """M ddq + h = E u + (0, f) at the samples, and M (dq_plus - dq_minus) = S' F at the impact."""
    data = orbit(name)
    equations, samples = data["statement"]["equations"], data["orbit"]["samples"]
    states, n = list(data["statement"]["states"]), len(data["statement"]["states"]) // 2 - 1
    actuators, modes = len(data["statement"]["control"]["actuators"]), data["evaluation"]["modes"]
    for row in samples["rows"]:
        at = dict(zip(samples["columns"], row, strict=True))
        names = {key: at[key] for key in (*states, "t")}
        e = values(data, names, {key: equations[key] for key in ("M", "h", "E")})
        block = modes[at["mode"]]
        solved = {**data, "statement": {**data["statement"], "definitions": block["definitions"]}}
        ddq = np.append(values(solved, names, {"rates": block["rates"]})["rates"][n + 1 :], 0.0)  # the foot has ddy = 0
        force = [*np.zeros(n), at["f_t"], at["f_n"]]
        u = row[-actuators:] if actuators else np.zeros(0)
        residual = e["M"] @ ddq + e["h"] - e["E"].reshape(n + 2, -1) @ u - force
        assert np.abs(residual).max() < 1e-9 * np.abs(e["h"]).max()
    (impact,) = (event for event in data["orbit"]["events"] if event["to"] == "impact")
    e = values(data, impact["state_before"] | {"t": impact["time"]}, equations)
    before, S = np.append([impact["state_before"][key] for key in states[n + 1 :]], 0.0), e["swing_jacobian"]
    after = before + np.linalg.solve(e["M"], S.T @ [impact["impulse"]["F_t"], impact["impulse"]["F_n"]])
    stated = impact["state_after"]
    assert np.append(e["relabel"], 0.0) == pytest.approx([stated[key] for key in states[: n + 1]], abs=1e-12)
    relabelled = np.atleast_2d(e["relabel_jacobian"]) @ after[:n]
    assert np.append(relabelled, (S @ after)[0]) == pytest.approx([stated[key] for key in states[n + 1 :]], abs=1e-12)


def tips(model: ET.Element, q: dict[str, float]) -> dict[str, tuple[float, float]]:
    """Places (x, z) of the feet of an MJCF file with its joints at ``q``."""
    found = {}

    def visit(body: ET.Element, place: np.ndarray, angle: float) -> None:
        def turned(x: float, z: float) -> np.ndarray:
            return np.array([x * np.cos(angle) + z * np.sin(angle), z * np.cos(angle) - x * np.sin(angle)])

        x, _, z = map(float, body.get("pos", "").split())
        place = place + turned(x, z)
        w, _, y, _ = map(float, body.get("quat", "").split())
        angle += 2 * np.arctan2(y, w)
        for joint in body.findall("joint"):
            along = np.array(joint.get("axis", "").split(), dtype=float) * q[joint.get("name", "")]
            place, angle = (place, angle + along[1]) if joint.get("type") == "hinge" else (place + along[::2], angle)
        for site in body.findall("site"):
            x, _, z = map(float, site.get("pos", "").split())
            found[site.get("name", "")] = tuple(place + turned(x, z))
        for child in body.findall("body"):
            visit(child, place, angle)

    for body in model.findall("worldbody/body"):
        visit(body, np.zeros(2), 0.0)
    return found


@pytest.mark.parametrize("name", [name for name in all_names() if orbit(name)["tree"]])
def test_an_mjcf_file_starts_where_the_orbit_does(name):
    """Feet on the ground, the stance foot at x = 0 with its speed; friction and gravity are those of the orbit."""
    data, model = orbit(name), ET.parse(SET / f"{name}.mjcf.xml").getroot()
    key, start = model.find("keyframe/key"), data["tree"]["start"]
    joints = [joint.get("name") for joint in model.iter("joint")]
    assert dict(zip(joints, map(float, key.get("qpos").split()), strict=True)) == {
        joint: start[joint]["position"] for joint in joints
    }
    places = [tips(model, {joint: start[joint]["position"] + t * start[joint]["rate"] for joint in joints})
              for t in (-1e-5, 0.0, 1e-5)]  # fmt: skip
    parameters = {key: entry["value"] for key, entry in data["statement"]["parameters"].items()}
    R = parameters.get("foot_radius", 0.0)
    state = {key: entry["value"] for key, entry in data["orbit"]["initial_state"].items()}
    known = state | {"t": 0.0} | {f"r{k}": value for k, value in enumerate(data["evaluation"]["arcs"][0]["r"])}
    swing = values(data, known, {"foot": data["statement"]["equations"]["swing_foot"]})["foot"]
    stance = min(places[1], key=lambda foot: abs(places[1][foot][0]) if R == 0 else foot)  # "stance_leg_foot" is first
    other = next(foot for foot in places[1] if foot != stance)
    assert places[1][stance][1] == pytest.approx(R, abs=1e-12)
    assert places[1][other][1] == pytest.approx(swing[1] + R, abs=1e-12)
    if R == 0:
        assert places[1][stance][0] == pytest.approx(0.0, abs=1e-12)
        assert places[1][other][0] == pytest.approx(swing[0], abs=1e-12)
        speed = (np.array(places[2][stance]) - places[0][stance]) / 2e-5
        assert speed == pytest.approx([state["dx"], 0.0], abs=1e-7)
    stated = values(data, known, {"g": data["statement"]["gravity"], "mu": data["statement"]["friction"]["kinetic"]})
    gravity = np.array(model.find("option").get("gravity").split(), dtype=float)
    assert gravity[::2] == pytest.approx(stated["g"], rel=1e-12, abs=1e-12)
    assert float(model.find("default/geom").get("friction").split()[0]) == pytest.approx(float(stated["mu"]))


def test_an_orbit_walks_in_mujoco_without_gaitopt():
    pytest.importorskip("mujoco", reason="needs pip install '.[engines]'")
    walk = runpy.run_path(str(ROOT / "docs" / "examples" / "orbit_in_mujoco.py"))["walk"]
    coarse, fine = (
        1e3 * x[times <= 0.5].max() for times, x, _ in (walk(SET / "compass-passive-a", dt) for dt in (2e-3, 1e-3))
    )
    assert 2 * fine - coarse == pytest.approx(4.050, rel=0.01)


@pytest.mark.parametrize("text", ["theta.real", "().__class__", "'1'", "[1]", "_x", "theta; 1"])
def test_a_formula_that_is_no_arithmetic_is_refused(text):
    spoiled = orbit("rimless-wheel-stick")
    spoiled["evaluation"]["modes"]["stick"]["rates"][0] = text
    with pytest.raises(ValueError, match=r"rimless-wheel-stick: .* is not arithmetic"):
        judge(spoiled)


def test_the_command_that_makes_the_set_draws_its_orbits():
    script = runpy.run_path(str(ROOT / "benchmarks" / "orbits.py"))
    assert script["picture"](go.solve("rimless-wheel-slip", progress=False))[:4] == b"\x89PNG"
    listed = script["readme"]([orbit(name) for name in all_names()])
    assert listed == (SET / "README.md").read_text()


@pytest.mark.parametrize("name", sampled(all_names(), 8))
def test_a_file_has_the_stated_format(name):
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.validate(orbit(name), json.loads((SET / "schema.json").read_text()))


def of_format_2(data: dict[str, Any]) -> dict[str, Any]:
    """The file that earlier versions wrote: without what ends a cycle, and with impulses only where a step ends."""
    data["format"] = "gaitopt-orbit-2"
    del data["statement"]["cycle_end"], data["statement"]["control"]["feedback"]
    for contact in data["statement"].get("contacts", {}).values():
        del contact["gap"], contact["places"], contact["partner"]
    for arc in data["evaluation"]["arcs"]:
        del arc["swaps"]
    for event in data["orbit"]["events"]:
        if "step_length" not in event:
            for key in ("impact", "impulse", "state_after"):
                event.pop(key, None)
    return data


@pytest.mark.parametrize("name", sampled(["heel-toe", "kneed-passive", "crawler", "compass-unequal"], 2))
def test_a_file_of_the_format_before_is_valid_and_recomputed(name):
    jsonschema = pytest.importorskip("jsonschema")
    data, schema = of_format_2(orbit(name)), json.loads((SET / "schema.json").read_text())
    jsonschema.validate(data, schema)
    assert differing(data) == []
    with pytest.raises(jsonschema.ValidationError, match=r"'(cycle_end|feedback|swaps|gap)' is a required property"):
        jsonschema.validate({**data, "format": "gaitopt-orbit-3"}, schema)


TWO = ("add", "sub", "mul", "div", "pow", "atan2", "fmax", "fmin", "hypot", "fmod", "copysign", "lt", "le", "eq", "ne",
       "logic_and", "logic_or", "if_else_zero")  # fmt: skip
ONE = ("neg", "sq", "sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh",
       "acosh", "atanh", "expm1", "log1p", "erf", "fabs", "sign", "floor", "ceil", "logic_not")  # fmt: skip


def test_every_operation_of_an_expression_has_the_value_and_the_slope_of_its_formula():
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    one = {"neg": -x, "sq": x**2, "acosh": ca.acosh(1 + x)}
    two = {"add": x + y, "sub": x - y, "mul": x * y, "div": x / y, "pow": x**y, "lt": x < y, "le": x <= y, "eq": x == y,
           "ne": x != y, "if_else_zero": ca.if_else(x < y, x, 0)}  # fmt: skip
    values = {name: one[name] if name in one else getattr(ca, name)(x) for name in ONE}
    values |= {name: two[name] if name in two else getattr(ca, name)(x, y) for name in TWO}
    values |= {"2*x": x + x, "1/x": 1 / x, "x**3.3": x**3.3}
    definitions, texts = formulas({"x": x, "y": y}, values)
    function = ca.Function("f", [x, y], [ca.vertcat(*values.values()), ca.jacobian(ca.vertcat(*values.values()), x)])
    used = ca.Function("f", [x, y], [ca.vertcat(*values.values())])
    data = {"name": "operations", "statement": {"states": ["x", "y"]}}
    evaluate = PROGRAM["function"](data, definitions, [text[0][0] for text in texts.values()], {})
    for at in ([0.3, 0.7], [0.7, 0.3], [0.4, 0.4], [0.9, -0.2]):
        known, slopes = (np.asarray(value).ravel() for value in function(*at))
        with np.errstate(invalid="ignore"):
            found, derivatives, _ = PROGRAM["derivative"](evaluate, 0.0, np.array(at))
        sound = np.isfinite(known)
        np.testing.assert_allclose(found[sound], known[sound], rtol=1e-14, atol=1e-15)
        smooth = sound & np.isfinite(slopes) & (at[0] != at[1])  # fmax, fmin and comparisons have a kink there
        np.testing.assert_allclose(derivatives[smooth, 0], slopes[smooth], rtol=1e-13, atol=1e-14)
    operations = {used.instruction_id(k) for k in range(used.n_instructions())}
    assert {*OPERATIONS} - {ca.OP_ASSIGN} <= operations


def test_the_page_names_every_field():
    page = (ROOT / "docs" / "developer" / "orbit-format.md").read_text()

    def fields(schema: Any) -> set[str]:
        parts = schema.values() if isinstance(schema, dict) else schema if isinstance(schema, list) else ()
        own = schema.get("properties", {}) if isinstance(schema, dict) else {}
        return set(own).union(*(fields(part) for part in parts))

    unnamed = {
        name for name in fields(json.loads((SET / "schema.json").read_text())) if not re.search(rf"\b{name}\b", page)
    }
    assert unnamed == set()


def test_the_set_has_about_thirty_orbits_of_ten_mechanisms_and_laws():
    orbits = [orbit(name) for name in all_names()]
    assert len(orbits) >= 30
    assert {o["name"] for o in orbits} <= set(go.problem_names())
    laws = {(o["mechanism"], o["statement"]["control"]["type"], o["statement"]["impact_law"]) for o in orbits}
    assert len({o["mechanism"] for o in orbits}) >= 10
    assert len(laws) >= 15
    assert {o["name"] for o in orbits if not o["proved"]} == {
        "slip-run-foot", "flat-foot", "bounding", "slip-walk-stable"
    }  # fmt: skip


def test_the_checksums_are_those_of_all_files():
    sums = dict(line.split("  ")[::-1] for line in (SET / "SHA256SUMS").read_text().splitlines())
    files = {str(path.relative_to(SET)): path for path in SET.rglob("*") if path.is_file()}
    files = {name: path for name, path in files.items() if "__pycache__" not in name and name != "SHA256SUMS"}
    assert sums == {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
    for certificate in (orbit(name)["certificate"] for name in all_names()):
        assert certificate is None or sums[certificate["file"]] == certificate["sha256"]


def test_every_number_of_a_proved_orbit_lies_near_its_enclosure():
    for name in all_names():
        motion = orbit(name)["orbit"]
        numbers = [motion["period"], motion["spectral_radius"], *motion["initial_state"].values()]
        numbers += [phase["duration"] for phase in motion["phases"]]
        for number in numbers if orbit(name)["proved"] else []:
            low, high = map(float, number["enclosure"])
            assert low - 1e-11 <= number["value"] <= high + 1e-11, name
        for m in motion["multipliers"]:
            for part in ("re", "im") if m["enclosure"] else ():
                low, high = map(float, m["enclosure"][part])
                assert low - 2e-11 <= m[part] <= high + 2e-11, name  # their accuracy as the page states it


def test_a_file_is_remade_as_it_is_with_the_exact_values_of_its_problem():
    problem = go.load_problem(A)
    decimals = ExactValues(write_problem(problem))
    exact = {key: decimals(key, float(value)) for key, value in problem.parameters.items()}
    assert {entry["key"]: entry["exact"] for entry in orbit(A)["statement"]["parameters"].values()} == exact
    assert exact["walker.slope"] == "1 deg"
    stored = orbit("compass-passive-static-kinetic")
    exact = {entry["key"]: entry["exact"] for entry in stored["statement"]["parameters"].values()}
    made = json.loads(json.dumps(orbit_record(go.solve(stored["name"], progress=False), exact)))
    assert made["statement"] == stored["statement"]
    assert made["evaluation"]["modes"] == stored["evaluation"]["modes"]
    assert made["evaluation"]["resets"] == stored["evaluation"]["resets"]
    assert made["orbit"]["period"]["value"] == pytest.approx(stored["orbit"]["period"]["value"], rel=1e-12)
    for row, kept in zip(made["orbit"]["samples"]["rows"], stored["orbit"]["samples"]["rows"], strict=True):
        assert row[1] == kept[1]
        assert row[:1] + row[2:] == pytest.approx(kept[:1] + kept[2:], rel=1e-8, abs=1e-8)
