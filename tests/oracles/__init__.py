"""Independent programs that the package is checked against; none imports it."""
