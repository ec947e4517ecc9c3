"""The same front in closed form.

`double_series`     the series that solves the recursion, on the lattice and on a line
`crossing`          the search for where the front stress first falls to the threshold
`front`             what users call: length, record, stress and fields
`bulk`              the same by the million; long fronts; where the contact at the edge breaks again
`continuum`         the limit of small contacts, self-consistent in both layers
`crack`             the crack-like front, whose contacts slide until it stops
"""
