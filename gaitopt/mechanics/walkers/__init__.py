"""The walkers that come with gaitopt, one file each."""
