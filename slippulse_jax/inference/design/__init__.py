"""Design experiments: rank candidates by the information expected about the interface stiffness."""
