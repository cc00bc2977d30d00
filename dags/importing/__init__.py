"""Registering captures."""
