"""Settings for the seconds one has."""
