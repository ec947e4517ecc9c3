"""Predictions of what was measured, from the parameters of a fit.

In the order in which they build on each other:

`inputs`            names and domains of what a model takes
`interpolation`     values between nodes that are computed as needed
`family`            lengths of whole events of blocks, by families of blocks
`sequence`          series of events by their numbers, and surfaces through them
`fronts`            a class for each model of a length
`observables`       what is measured beside the length
`parameters`        what is fitted, and the linear map to the inputs
`check`             what is refused, or suspected, before anything is computed
"""
