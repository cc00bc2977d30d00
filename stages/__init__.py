"""The craft: pure functions from arrays to arrays, and one declaration a stage."""
