"""The page of an archive: every sequence, what became of it, and what to do next."""
