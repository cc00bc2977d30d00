"""Looking after an archive: verify, free, cut anew, accept."""
