"""All gaits of a problem, whatever their mode sequence; the one that ``solve`` returns; why there is none.

Every search raises ``KeyboardInterrupt`` when ``should_stop`` returns True.
"""
