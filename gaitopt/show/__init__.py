"""Tables, figures and pages of results.

catalogue     the figures of every kind of result by name
gaits         figures of gaits and walks
branches      figures of branches, and of Floquet multipliers in the complex plane
grids         figures of sweeps, basins and fronts
pages         reports of gaits, branches and walks as single HTML files; templates and scripts are in web/
film          the drawing of a walker, and its motion on a page
motion        the steps that figures and pages draw
tables        tables in a terminal and in a notebook
style         words and units of quantities, colours, line styles, panels and legends of all figures
"""
