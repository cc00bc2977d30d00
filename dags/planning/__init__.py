"""What a run would do and why: contexts, tasks, fingerprints, plans, costs. Reads receipts, never data."""
