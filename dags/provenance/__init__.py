"""Which code computed what: digests of kernels and of whole processes."""
