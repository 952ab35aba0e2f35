"""What people read: the pages of a case and of a diagnosis, their tables, figures and words."""
