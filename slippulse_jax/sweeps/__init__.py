"""Sweeps: the first precursor over ranges of its parameters, labelled, of any size, on one machine or many."""
