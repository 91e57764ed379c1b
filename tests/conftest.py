"""Settings of the whole test suite: generated examples are the same in every run."""

from hypothesis import settings

settings.register_profile("reproducible", derandomize=True, deadline=None)
settings.load_profile("reproducible")
