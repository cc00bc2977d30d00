"""Measures of rendered pictures against pictures that were kept aside."""
