"""Tables, figures and pages of results.

- ``catalogue``: the figures of every kind of result by name.
- ``gaits``: figures of gaits and walks.
- ``branches``: figures of branches, and of Floquet multipliers in the complex plane.
- ``atlases``: the picture of an atlas over two parameters.
- ``grids``: figures of sweeps, basins and fronts.
- ``attractors``: the bifurcation diagram, with the attractors of walks over a parameter.
- ``robustness``: the disturbances that a walk survives, and the table of its limits.
- ``programs``: the sparsity of a nonlinear program.
- ``replays``: figures of replays in other physics engines.
- ``movie``: the moving walker as GIF or MP4, and as a row of postures.
- ``pages``: reports of gaits, branches and walks as single HTML files; templates and scripts are in web/.
- ``film``: the drawing of a walker, and its motion on a page.
- ``motion``: the steps that figures and pages draw.
- ``tables``: tables in a terminal and in a notebook.
- ``orbits``: a gait as a reference orbit, a JSON object that states its equations.
- ``robots``: a walker's links as URDF or MJCF.
- ``style``: labels and units of quantities, colours, line styles, panels and legends of all figures.
"""
