"""Search for gaits: over all mode sequences, from the gait of a problem's file, and why there is none.

Its modules are imported one by one: to solve a given mode sequence takes none of what searches for others.

Every search ends with a ``KeyboardInterrupt`` where ``should_stop`` became true.
"""
