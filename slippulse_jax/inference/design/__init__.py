"""Which experiment to do next."""
