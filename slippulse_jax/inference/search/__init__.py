"""The search for every set of parameters that the data allow.

In the order in which they build on each other:

`likelihood`        log density of measurements and priors
`minimise`          minimisation from many starts at once
`minima`            every minimum of the deviance that the data do not exclude
`learning`          where an expensive model is followed, and its emulator
`intervals`         how far a parameter may move, by profile, simulation or counts
"""
