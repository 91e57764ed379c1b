"""Continuation of gaits in a parameter, through folds, bifurcations and changes of the mode sequence.

request       the parameter, its targets and bounds, and which other branches to follow
monitors      functions of a gait whose zeros are special points
curve         the curve of gaits with one mode sequence
change        the mode sequence that follows where one ends
switching     the other branches through a special point
continuation  the iterable that follows a family, curve after curve
"""
