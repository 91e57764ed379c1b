"""Multiple shooting of a given mode sequence: equations, Newton's method, IPOPT."""
