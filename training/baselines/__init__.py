"""The other systems of the paper's tables, re-created on the same data (paper, section 5.1)."""
