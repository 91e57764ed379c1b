"""Searches for gaits: the one that ``solve`` returns, all gaits of a problem, and why a gait does not exist.

- ``solve``: the gait of a problem, with one meaning for all callers.
- ``over``: designs over a range of a parameter: one control with a stable gait at every value.
- ``starts``: start states of the walks of a search, in a box or around a guess.
- ``candidates``: proposals for gaits of unknown mode sequence, by simulation and along families.
- ``candidate``: one cycle as its mode sequence and first state, not solved yet.
- ``scan``: where the return map can have fixed points, on a section of one or two coordinates.
- ``find``: the gaits of the candidates, each solved, verified and listed once.
- ``attractors``: cycles, tori and chaos on which walks from many states settle, with their Lyapunov exponents.
- ``stabilise``: a feedback law that walks a known gait stably; ``joint_curves``: the curves that its joints follow.
- ``explain``: violated conditions, and the nearest parameters at which a mode sequence exists.

Every search raises ``KeyboardInterrupt`` when ``should_stop`` returns True.
"""
