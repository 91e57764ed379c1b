"""Results as data: gaits, trajectories, branches, their scalars and their records."""
