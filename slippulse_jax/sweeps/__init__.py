"""Sweeps of the first precursor over ranges of its parameters."""
