"""Estimators of 2D joints behind one interface."""
