"""Long work that is kept line by line in a run folder: sweeps, fronts, basins, many starts, searches."""
