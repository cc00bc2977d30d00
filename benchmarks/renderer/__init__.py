"""The renderer on processors and GPUs, beside plain torch."""
