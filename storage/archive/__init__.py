"""The archive: sequences, shards, receipts, leases, ledger."""
