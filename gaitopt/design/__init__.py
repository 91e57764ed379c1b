"""Designs: gaits with free parameters, an objective and constraints.

design            a design from its start to its outcome
open_loop         optimal open-loop torques, by direct collocation
stability         bounds of the multipliers for them
smoothed          the smoothed problem over nodes, durations and freed parameters, for IPOPT; conflicting constraints
exact             the exact problem in the freed parameters alone: objective and constraints with their gradients
sensitivity       curves and scalars of a gait with exact derivatives in the freed parameters
derivatives       derivatives of everything a result says about a gait, in every continuous parameter
spectral_radius   bounds of the multipliers for both problems, with gradients
sqp               sequential quadratic programming of the exact problem, and its optimality conditions
neighbourhood     an independent check: random neighbours of a design, none of which may be better
"""
