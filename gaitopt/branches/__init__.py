"""Continuation of gaits in a parameter, through folds, bifurcations and changes of modes, and in two.

- ``request``: the parameter, its targets and bounds, and which other branches to follow
- ``monitors``: functions of a gait whose zeros are special points
- ``curve``: the curve of gaits with one mode sequence
- ``change``: the mode sequence that follows at the end of another one
- ``switching``: the other branches through a special point
- ``steps``: the frame of a walk along a curve, step by step, with bounds, special points and changes of modes
- ``continuation``: the iterable that follows a family, curve after curve
- ``conditions``: the condition along a curve in two parameters: a critical multiplier, or a margin at zero
- ``normal_forms``: coefficients of bifurcations: whether stability is lost softly or hard
- ``codimension_two``: test functions along such curves
- ``trace``: the iterable that follows a special point in two parameters
"""
