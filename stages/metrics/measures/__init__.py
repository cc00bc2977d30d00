"""The measures of the metrics stage, one a file: what each declares, and the function that computes it."""
