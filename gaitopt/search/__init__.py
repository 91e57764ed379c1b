"""Search for gaits: over all mode sequences, from the gait of a problem's file, and why there is none.

Every search ends with a ``KeyboardInterrupt`` where ``should_stop`` became true.
"""
