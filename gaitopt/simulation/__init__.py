"""The forward hybrid simulator, which finds the contact modes itself, on scipy or heyoka.

- ``events``: when and where a margin counts as fallen; one set of rules for all engines
- ``natural``: the hybrid system in natural units
- ``engine``: the interface of an engine, which integrates arcs from event to event; the choice of an engine
- ``scipy_stepper``: the engine with Runge-Kutta steps
- ``heyoka_stepper``: the engine with Taylor series (needs heyoka)
- ``heyoka_code``: functions of CasADi compiled by heyoka (needs heyoka)
- ``contact_forces``: forces and impulses in all modes at once
- ``clear_cases``: decisions about a lone foot that rounding cannot change, for one state or many
- ``contact_resolver``: the states of the contacts at rest and after an impact
- ``ground``: the parameters of a walker on tiles, step by step
- ``simulator``: the hybrid loop: steps and walks
- ``outcomes``: outcomes of steps, as records and as arrays
- ``heyoka_batch``: steps of many states at once (needs heyoka)
"""
