"""Runs: tasks in flight, workers, failures, leases, events."""
