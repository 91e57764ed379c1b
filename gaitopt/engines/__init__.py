"""Other physics engines, in which a gait is replayed; each is imported when it is used.

- ``replay``: the runs of a gait at different time steps, and the verdict whether they converge to the gait
- ``outcome``: one run at one time step, compared with the gait
- ``process``: a separate process for the runs, so that an engine that crashes does not end this program
- ``plant``: the walker as a tree of rigid bodies in numbers, and the gait that an engine has to reproduce
- ``drake``, ``mujoco``, ``pybullet``, ``siconos``: the adapters of the engines
"""
