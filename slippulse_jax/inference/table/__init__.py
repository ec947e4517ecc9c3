"""A table of measurements: its columns, and what is read from it.

In the order in which they build on each other:

`columns`           each column, with its names, unit and domain
`tables`            text of files, and DataFrames, to columns of numbers
`measurements`      measured lengths and readings of gauges
"""
