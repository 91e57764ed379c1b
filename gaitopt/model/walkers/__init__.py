"""The walkers that come with gaitopt, one class each."""
