"""Everything about machines and nothing about friction: chunks, threads, devices, habits of the compiler."""
