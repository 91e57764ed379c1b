"""Gaits of a given mode sequence by multiple shooting.

From a problem to its gait:

- ``solve``: the path: guess, Newton's method or IPOPT, refinement, check.
- ``rollout``: the first guess: the motion integrated along the mode sequence, and its mesh.
- ``mesh``: arcs and shooting intervals of a cycle.
- ``shooting``: the equations of a cycle: equalities, margins, labels of their rows, Jacobian.
- ``interval``: one shooting interval: Runge-Kutta step, samples, derivatives.
- ``newton``: a solution, Newton's method, integration error, refinement.
- ``return_map``: derivatives of the return map of a solution, of any order.
- ``sparse``: sparse matrices and their QR factors.
- ``ipopt``: nonlinear programs in blocks of unknowns and rows; IPOPT through CasADi.
- ``diagnosis``: why a motion is not a gait.
- ``assembly``: from a solution to its gait and back.
- ``program``: the nonlinear program of a gait, for IPOPT and for users; the check of a solution.

Direct collocation of one step, for unknown torques and for guesses that are not a motion:

- ``collocation_mesh``: intervals, points and the numbers of their states.
- ``collocation_elements``: expressions of a point, an impact and the scalars.
- ``collocation_rows``: unknowns, rows and the program, which problems that differ in numbers only share.
- ``collocation``: bounds, start, search and diagnosis of one problem.
- ``elements``: sums of small functions with exact sparse derivatives.
- ``first_gait``: a gait from a step length and a duration.

Other uses of the same equations:

- ``arclength``: curves of solutions of any equations: predictor, corrector, location of zeros.
- ``following``: a known gait at other parameter values: ``follow``, ``Family``.
- ``jets``: directional derivatives of any order of the equations of a gait.
- ``feedback_gains``: the linearised return map of a gait, and gains of feedback from step to step.
"""
