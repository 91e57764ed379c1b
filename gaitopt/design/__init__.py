"""Designs: gaits with free parameters, an objective and constraints.

- ``design``: a design from its start to its outcome.
- ``open_loop``: optimal open-loop torques, by direct collocation.
- ``stability``: bounds on the multipliers of gaits under open-loop torques.
- ``smoothed``: the smoothed problem over nodes, durations and freed parameters, for IPOPT; conflicting constraints.
- ``exact``: the exact problem in the freed parameters only: objective and constraints with their gradients.
- ``sensitivity``: curves and scalars of a gait with exact derivatives by the freed parameters.
- ``derivatives``: derivatives of every quantity of a result by every continuous parameter.
- ``spectral_radius``: bounds on the multipliers for the smoothed and the exact problem, with gradients.
- ``sqp``: sequential quadratic programming of the exact problem, and its optimality conditions.
- ``neighbourhood``: an independent check: random neighbours of a design, none of which may be better.
"""
