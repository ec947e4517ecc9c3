"""Recover a threshold or prestress that varies along the interface from measured lengths."""
