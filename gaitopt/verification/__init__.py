"""Comparison of a gait with the simulation.

- ``return_map``: the simulator's return map: derivative, fixed points, differences
- ``step_map``: the return map of thousands of states at once
- ``tiled_walks``: many walks at once on tiles of their own, and whether they return to a gait
- ``walk``: simulated walks of any length
- ``verify``: claims about a gait, each with figure and tolerance
"""
