"""Continuation of gaits in a parameter, through folds, bifurcations and changes of the mode sequence.

request       the parameter, its targets and bounds, and which other branches to follow
monitors      functions of a gait whose zeros are special points
curve         the curve of gaits with one mode sequence: pseudo-arclength, location of zeros
change        from one mode sequence to the next
switching     the other branches through a special point
continuation  the walk along a family, and families of walks
"""
