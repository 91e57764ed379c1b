"""Make the set of reference orbits: ``python benchmarks/orbits.py [NAME ...]``; minutes if certificates are searched.

Every problem is solved, verified, and proved where proofs cover its walker. ``results/reference-orbits`` gets the
JSON, certificate and picture of each, MJCF and URDF where the walker is a tree, and the checksums of all files. A
certificate that is there is kept if it holds when it is checked again, and is that of the same problem.
"""

import argparse
import hashlib
import json
import re
from pathlib import Path
from textwrap import fill
from xml.etree import ElementTree as ET

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich.progress import track

import gaitopt as go
from gaitopt.api.verbs import check_proof
from gaitopt.engines.plant import tree_record
from gaitopt.gait.measures import observe
from gaitopt.model.modes import FOOT, OFF, SWING_FOOT, Mode
from gaitopt.problem.writing import ExactValues, write_problem
from gaitopt.proof.prove import stated_problem
from gaitopt.show.film import skeleton
from gaitopt.show.gaits import MODE_COLOURS
from gaitopt.show.motion import resampled
from gaitopt.show.orbits import orbit_record
from gaitopt.show.style import MODE_NAMES, dashes, encoded, figure_style

VERSION = "3.0.0"
"""Version of the set of orbits; a change of a number or a key changes it."""
FOLDER = Path(__file__).parents[1] / "results" / "reference-orbits"
POSTURES, SMOOTH = 8, 60
"""Postures of a step in a picture, and points of a curve of one arc."""
DPI, DIGITS, SMALLEST_SLIP = 90, 12, 0.05
"""Resolution; digits of a position [m], below which rounding would fill the axis; half of its smallest range [mm]."""
HEAD = """# Reference orbits

{count} periodic orbits of walkers with dry friction, of which {proved} are proved: existence, mode sequence and
multipliers. [docs/reference-orbits.md](../../docs/reference-orbits.md) describes the format, and how to use the set
without gaitopt. `python recompute.py NAME.json` recomputes an orbit with numpy and scipy, and ends with exit code
1 if a number of the file differs. Data: CC-BY-4.0; version {version}; checksums in `SHA256SUMS` (`sha256sum -c
SHA256SUMS`). `python benchmarks/orbits.py` at the root of the repository remakes the set.

| orbit | mechanism | modes; impact | period [s] | spectral radius | proof | links |
|---|---|---|---|---|---|---|
"""


def main() -> None:
    """Write the files of the named orbits, or of all; then the list and the checksums."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="orbits to remake, or named problems to add; by default all of the set"
    )
    names = parser.parse_args().names or members()
    (FOLDER / "certificates").mkdir(parents=True, exist_ok=True)
    for name in track(names, "orbits"):
        write_orbit(name)
    orbits = [json.loads((FOLDER / f"{name}.json").read_text()) for name in members()]
    (FOLDER / "README.md").write_text(readme(orbits))
    files = sorted(path for path in FOLDER.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    sums = [f"{sha256(path)}  {path.relative_to(FOLDER)}\n" for path in files if path.name != "SHA256SUMS"]
    (FOLDER / "SHA256SUMS").write_text("".join(sums))


def members() -> list[str]:
    """Names of the orbits of the set."""
    return sorted(path.stem for path in FOLDER.glob("*.json") if path.stem != "schema")


def write_orbit(name: str) -> None:
    """All files of one orbit."""
    gait = go.solve(name, progress=False)
    if not gait.converged or not go.verify(gait).passed:
        raise SystemExit(f"{name} is {gait.status}, or its verification fails: {gait.message}")
    file = FOLDER / "certificates" / f"{name}.json"
    decimals = ExactValues(write_problem(stated_problem(gait)))
    exact = {key: decimals(key, value) for key, value in gait.dynamics.parameters.items()}
    theorem, unproved = prove(gait, exact, file)
    certificate = {"file": f"certificates/{name}.json", "sha256": sha256(file)} if theorem else None
    record = orbit_record(gait, exact, theorem=theorem, certificate=certificate, unproved=unproved)
    record = {"version": VERSION, **record, "tree": tree_record(gait)}
    (FOLDER / f"{name}.json").write_text(compact(record))
    (FOLDER / f"{name}.png").write_bytes(picture(gait))
    if record["tree"] is not None:
        values = dict(zip(type(gait.problem.walker).model_fields, gait.dynamics.p, strict=False))  # of a design too
        walker = gait.problem.walker.model_copy(update=values)
        mjcf, urdf = (go.robot_description(walker, kind) for kind in ("mjcf", "urdf"))
        (FOLDER / f"{name}.urdf").write_text(urdf)
        (_, kinetic, _), *_ = gait.system.contact_coefficients(gait.dynamics.p).values()
        (FOLDER / f"{name}.mjcf.xml").write_text(at_start(mjcf, record["tree"]["start"], float(kinetic)))


def at_start(mjcf: str, start: dict, friction: float) -> str:
    """An MJCF file with the friction of an orbit, and its initial state as the keyframe ``start``."""
    root = ET.fromstring(mjcf)
    joints = [start[joint.get("name")] for joint in root.iter("joint")]
    default = ET.Element("default")
    ET.SubElement(default, "geom", friction=f"{friction!r} 0 0")
    root.insert(1, default)
    positions, rates = (" ".join(repr(joint[key]) for joint in joints) for key in ("position", "rate"))
    ET.SubElement(ET.SubElement(root, "keyframe"), "key", name="start", qpos=positions, qvel=rates)
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def prove(gait: go.Gait, exact: dict[str, str], file: Path) -> tuple[dict | None, str | None]:
    """The theorem about a gait, whose certificate is in ``file``; or why there is none."""
    proof = check_proof(file) if file.exists() else None
    kept = {} if proof is None or not proof.proved else proof.statement  # designed values may change by rounding
    if (kept.get("sha256"), kept.get("parameters")) != (gait.problem.digest, exact):
        proof = go.prove(gait, progress=False)
        if not proof.proved:
            return None, "; ".join(claim.finding for claim in proof.claims if not claim.proved)
        file.write_text(compact(proof.certificate))
    return json.loads(json.dumps(proof.to_record())), None


def compact(record: dict) -> str:
    """JSON with one line per list of numbers or texts."""
    text = json.dumps(record, indent=1, ensure_ascii=False)
    return re.sub(r"\[\s+([^\[\]{}]*?)\s+\]", lambda found: "[" + " ".join(found[1].split()) + "]", text) + "\n"


def sha256(path: Path) -> str:
    """Checksum of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def picture(gait: go.Gait) -> bytes:
    """Postures, ratio of the contact forces with the cone, and path of every contact along the ground, as PNG."""
    with figure_style():
        figure = Figure(figsize=(6.4, 6.0))
        posture, ratio, slip = figure.subplots(3, 1, height_ratios=(2, 1, 1))
    walked, began, names = 0.0, 0.0, gait.system.walker.contact_names()
    for step in gait.steps:
        paths = dict.fromkeys(names, 0.0)
        for arc in step.arcs:
            fine = resampled(arc, SMOOTH)
            observed, h = observe(fine), fine.times[1] - fine.times[0]
            for k, name in enumerate(names):
                state = Mode.of_feet({FOOT: arc.mode.contacts[name], SWING_FOOT: OFF})
                style = {"color": MODE_COLOURS[state], "linestyle": dashes(arc.mode)}
                force, speed = observed.force[:, 2 * k : 2 * k + 2], observed.slip[:, k]
                path = paths[name] + np.append(0.0, np.cumsum((speed[1:] + speed[:-1]) / 2 * h))
                paths[name] = float(path[-1]) if name in arc.mode.touching else 0.0
                if name in arc.mode.touching:
                    share = force[:, 0] / np.where(force[:, 1] == 0, np.nan, force[:, 1])
                    ratio.plot(began + fine.times, share, **style)
                if name in arc.mode.touching or not gait.system.walker.contacts:
                    slip.plot(began + fine.times, 1e3 * path.round(DIGITS), **style)
            drawn = skeleton([resampled(arc, max(2, round(POSTURES * arc.duration / step.period)))])
            for points in drawn.points:
                for a, b in drawn.legs:
                    stance = 0 in (a, b) or not {a, b}.isdisjoint(drawn.contacts)
                    posture.plot(
                        walked + points[[a, b], 0], points[[a, b], 1], lw=1.2, alpha=0.9 if stance else 0.4,
                        color=MODE_COLOURS.get(arc.mode.contact, "0.3"),
                    )  # fmt: skip
        began, walked = began + step.period, walked + step.final_impact.step_length
    for side in (-1, 1):
        for static, _, _ in gait.system.contact_coefficients(gait.dynamics.p).values():
            ratio.axhline(side * static, color="0.5", lw=0.9, ls="-.")
    posture.set_aspect("equal", adjustable="box")
    posture.set(title=fill(f"{gait.problem.name}: {gait.cycle}".replace("_", " "), 80), xlabel="x [m]", ylabel="y [m]")
    posture.title.set_fontsize(9)
    ratio.tick_params(labelbottom=False)
    ratio.set(ylabel="f_t / f_n", xlabel="")
    slip.set(ylabel="path [mm]" if gait.system.walker.contacts else "foot x [mm]", xlabel="t [s]")
    low, high = slip.get_ylim()
    slip.set_ylim(min(low, -SMALLEST_SLIP), max(high, SMALLEST_SLIP))
    ratio.set_xlim(slip.get_xlim())
    entries = [
        Line2D([], [], color=MODE_COLOURS[mode], linestyle=dashes(mode), label=MODE_NAMES[mode])
        for mode in dict.fromkeys(
            Mode.of_feet({FOOT: mode.contacts[name], SWING_FOOT: OFF})
            for mode, _ in gait.phases
            for name in names
            if name in mode.touching or not gait.system.walker.contacts
        )
    ]
    entries.append(Line2D([], [], color="0.5", lw=0.9, ls="-.", label="cone"))
    with figure_style():
        figure.legend(handles=entries, loc="outside lower center", ncols=4)
    return encoded(figure, "png", DPI)


def readme(orbits: list[dict]) -> str:
    """The list of the orbits."""
    rows = []
    for orbit in orbits:
        motion, name = orbit["orbit"], orbit["name"]
        modes, impacts = (
            ", ".join(Mode(mode).brief for mode in recorded)
            for recorded in (
                [phase["mode"] for phase in motion["phases"]],
                [event["impact"] for event in motion["events"] if event["to"] == "impact"],
            )
        )
        tree = f"[MJCF]({name}.mjcf.xml), [URDF]({name}.urdf)" if (FOLDER / f"{name}.urdf").exists() else ""
        proof = f"[proved](certificates/{name}.json)" if orbit["proved"] else "not proved"
        radius = f"{motion['spectral_radius']['value']:.4f}"
        rows.append(
            f"| [{name}]({name}.json) ([picture]({name}.png)) | {orbit['mechanism']} | "
            f"{modes}; impact: {impacts or 'none'} | "
            f"{motion['period']['value']:.6f} | {radius} | {proof} | {tree} |\n"
        )
    count = sum(orbit["proved"] for orbit in orbits)
    return HEAD.format(version=VERSION, count=len(orbits), proved=count) + "".join(rows)


if __name__ == "__main__":
    main()
