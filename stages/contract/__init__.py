"""What a stage declares, what its kernel sees, and the facts it is turned on by."""
