"""Continuation of gaits in a parameter, through folds, bifurcations and changes of the mode sequence."""
