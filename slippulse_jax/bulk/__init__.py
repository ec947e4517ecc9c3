"""Chunks of lanes, threads, devices and compiler options. No physics here."""
