"""The paper's figures, claims, errata and equations."""
