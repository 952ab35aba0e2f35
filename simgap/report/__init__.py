"""Pages of a case and of a diagnosis: their tables, figures and words."""
