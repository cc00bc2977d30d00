"""The measures and constants of a sequence, one a file: what each declares, and how it looks at the sample."""
