"""How robust a gait is on a floor that nobody knows exactly.

- ``derivatives``: exact derivatives of one step by its start state and by the tiles under its feet
- ``norm``: the gait sensitivity norm, from one tile to period, step length, clearance and distance to the cone
- ``limits``: the first patch, step, slope or push from which a walk does not return to the gait
- ``interval``: the interval of a parameter in which the same control has a stable gait
- ``falls``: the mean number of steps to a fall on random floors
"""
