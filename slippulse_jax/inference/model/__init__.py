"""Models of precursors, a class in one file each.

In the order in which they build on each other:

`inputs`            names and domains of what a model takes
`interpolation`     values between nodes that are computed as needed
`emulator`          outputs of an expensive model as smooth functions, with their covariance
`family`            lengths of whole events of blocks, by families of blocks
`front`             what a model is: its inputs, lengths, range and words
`slider`            first fronts of sliders, and their whole events
`crack`             crack-like fronts
`block`             whole events of blocks that are pushed at a height
`series`            the events of a block up to sliding
`scattered`         the first event that would be noticed, of contacts that differ
`models`            the choice of a model by a table
"""
