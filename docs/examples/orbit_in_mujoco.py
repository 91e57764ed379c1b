"""A reference orbit in MuJoCo, without gaitopt: ``python orbit_in_mujoco.py FOLDER/compass-passive-a``."""

import json
import sys
from pathlib import Path

import mujoco
import numpy as np


def walk(path, dt=0.001):
    """Times [s] and position of the stance foot [m] in the first step of an orbit without torques."""
    orbit = json.loads(Path(f"{path}.json").read_text())
    model = mujoco.MjModel.from_xml_path(f"{path}.mjcf.xml")
    data = mujoco.MjData(model)
    model.opt.timestep, model.opt.integrator = dt, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.cone, model.opt.impratio, model.opt.tolerance = mujoco.mjtCone.mjCONE_ELLIPTIC, 100, 1e-14
    model.geom_solref[:], model.geom_solimp[:] = (2 * dt, 1), (0.99, 0.99, 0.001, 0.5, 2)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_forward(model, data)
    feet = [k for k in range(model.ngeom) if model.geom(k).name.endswith("_foot")]
    stance = min(feet, key=lambda k: abs(data.geom_xpos[k, 0]))  # it starts at x = 0
    swing = next(k for k in feet if k != stance)
    first, last = orbit["tree"]["swing_contact_off"][0]
    times, x = np.arange(0.0, 0.99 * orbit["orbit"]["events"][-1]["time"], dt), []
    for t in times:
        model.geom_contype[swing] = model.geom_conaffinity[swing] = not first <= t < last
        x.append(data.geom_xpos[stance, 0])
        mujoco.mj_step(model, data)
    return times, np.array(x), orbit


if __name__ == "__main__":
    times, x, orbit = walk(sys.argv[1])
    columns, rows = orbit["orbit"]["samples"]["columns"], orbit["orbit"]["samples"]["rows"]
    exact = np.array([[row[columns.index(name)] for name in ("t", "x")] for row in rows]).T
    for t in np.linspace(0, times[-1], 8):
        walked, stated = (1e3 * np.interp(t, *curve) for curve in ((times, x), exact))
        print(f"t = {t:.2f} s   x = {walked:7.3f} mm   exact {stated:7.3f} mm")
