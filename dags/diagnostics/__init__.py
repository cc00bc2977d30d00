"""What is shown of plans and runs: progress, tables, status, logs."""
