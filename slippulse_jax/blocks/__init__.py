"""A block under two-dimensional elasticity, on the contacts of a slider.

In the order in which they build on each other:

`guide`             the response of any uniform waveguide on attached contacts; the slider is one of two freedoms
`elements`          a block as such a guide: graded columns of finite elements
`pressed`           contacts of a guide whose stiffness and threshold follow a pressure that the push tilts
`event`             the contacts of a block, and its event on a given number of them
`size`              how many contacts are followed, and how large: one block, and many
"""
