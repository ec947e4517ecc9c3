"""What is no physics: outcomes, numbers with units and domains, choices, printing, files and processes."""
