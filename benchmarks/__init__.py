"""Measurements by subject, each printed as a table and kept in benchmarks/results/NAME.json. Never part of the
tests."""
