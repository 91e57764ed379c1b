"""Points that an iteration tries: one that diverges ends the attempt as data, in silence, on every processor.

Its values overflow, and are seen by not being finite. Whether numpy would also warn of it depends on the vector unit
that computes them.
"""

import numpy as np


def overflow_allowed() -> np.errstate:
    """Decorator or context of what computes with trial points."""
    return np.errstate(over="ignore", invalid="ignore")
