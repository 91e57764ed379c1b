"""Other physics engines, in which a gait is replayed; each is imported when it is used.

replay     the runs of a gait at several time steps, and whether they tend to the gait
outcome    one run, measured against the gait
process    a process for the runs, so that a crash of an engine is a result
plant      the walker as a tree of rigid bodies in numbers, and the gait that an engine has to reproduce
drake, mujoco, pybullet, siconos  adapters of the engines
"""
