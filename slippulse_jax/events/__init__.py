"""Events of any body: contacts break in any order, most overloaded first.

`event`             break after break at a fixed load: the one loop
`first`             from a relaxed body to the load at which a contact breaks, and to the length of the event
`rupture`           nucleation and one rupture of a chain, under the hard rule or a smooth one
`ageing`            thresholds that grow with age
`catalogue`         the record of a series of events, and its files
`series`            one event after another, as the load grows
`scattered`         the first event that would be noticed, of contacts whose thresholds differ
`inertia`           the chain with masses
"""
