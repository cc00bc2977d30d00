"""What `view` does: the page of a sequence, served while it is being computed."""
