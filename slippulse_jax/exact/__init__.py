"""The same front in closed form (the series itself is `slippulse_jax.double_series`).

`crossing`          the search for where the front stress first falls to the threshold
`front`             what users call: length, record, stress and fields
`bulk`              the same by the million; long fronts; where the contact at the edge breaks again
`crack`             the crack-like front, whose contacts slide until it stops
"""
