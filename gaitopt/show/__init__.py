"""Tables, figures and pages of results.

catalogue     the figures of every kind of result by name
gaits         figures of gaits and walks
multipliers   Floquet multipliers in the complex plane
families      figures of branches, fronts, sweeps and basins
pages         reports of gaits, branches and walks as single HTML files; templates and scripts are in web/
film          the moving walker on a page
walker        the drawing of a walker
motion        the steps that figures and pages draw
tables        tables in a terminal and in a notebook
labels        words, symbols and units of quantities
style         colours, line styles, panels and legends of all figures
"""
