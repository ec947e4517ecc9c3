"""The commands of `slippulse`, one a module; each imports what it needs when it runs."""
