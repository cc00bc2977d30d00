"""Simulated captures: filmed, registered, run."""
