"""Chunks of lanes, threads, devices, compiler options and kept programs.

No physics here.
"""
