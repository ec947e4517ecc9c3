"""Events in which contacts break in any order, the most overloaded next, on any body.

`event`             break after break at a fixed load: the one loop
`rupture`           nucleation and one rupture of a chain, under the hard rule or a smooth one
`block`             the event of a block under two-dimensional elasticity, on a given number of contacts
`resolution`        how many contacts of a block are followed: first precursors of one block, and lengths of many
`ageing`            thresholds that grow with age
`catalogue`         the record of a series of events, and its files
`series`            one event after another, as the load grows
`inertia`           the chain with masses
"""
