"""From measured precursor lengths back to the interface.

In the order in which a fit reads them, from a table to the printed report; the imports of each room run down this list:

`choices`           words for what a fit may be asked for
`table/`            a file, or arrays, and the measurements that it holds
`model/`            models of precursors, and an emulator of expensive ones
`observables/`      kinds of data: readings, predictions and words
`parameters`        what is fitted, its check, and the linear map to the inputs of a model
`search/`           how probable the data are; minima; intervals
`result/`           verdicts, what would move the fit, record and report
`fit`               the door: a table in, a result out
`objective`         the door for an optimiser or sampler of one's own
`mechanism`         pulse or crack: two fits of one table, compared
`knowledge`         what is known of the stiffness, and what a further experiment would tell
`design`            candidate experiments, ranked by that
`heterogeneous`     lengths on an interface that is not uniform, and their derivatives
`recover`           the profile of thresholds or prestress, from such lengths
"""
