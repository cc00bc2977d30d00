"""The network itself: torch modules."""
