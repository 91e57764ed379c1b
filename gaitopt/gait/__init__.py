"""Results as data: gaits, trajectories, branches, their scalars and their records.

- ``curves``: smooth curves given by their values at Chebyshev points: integrals, extrema, roots
- ``trajectory``: arcs of one mode, impacts, steps, simulated trajectories and their endings
- ``measures``: the scalars of steps as numbers
- ``impacts``: the impacts of a motion with the impulses at all contacts
- ``shares``: contact forces that the equations of motion do not determine, and their bounds
- ``zero_dynamics``: the motion on the surface of virtual constraints: delta^2 and the potential
- ``gait``: ``Gait``: status, cycle of steps, multipliers, scalars, causes of failure
- ``ranges``: what a design over a range of a parameter has shown there
- ``branch``: ``Branch``: points, special points, cascades of period doublings
- ``trace``: ``Trace``: a special point in two parameters, its curve and codimension-two points
- ``regions``: branches at some values of a second parameter, arranged into regions, sheets and curves
- ``records``: types of all records, and the identities that their numbers satisfy
- ``frames``: tables as pandas data frames and xarray datasets
"""
