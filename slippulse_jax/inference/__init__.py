"""From measured precursor lengths back to the interface."""
