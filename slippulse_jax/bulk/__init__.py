"""How many lanes are computed at once: chunks, threads, devices, compiler options. No physics here."""
