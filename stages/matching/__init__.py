"""Stereo matching: costs, aggregation, sweeps, semi-global matching, fusion."""
