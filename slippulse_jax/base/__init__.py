"""No physics: outcomes, numbers with units and domains, printing, files, processes."""
