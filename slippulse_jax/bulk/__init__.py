"""Chunks, threads, devices and compiler settings, with no friction in them."""
