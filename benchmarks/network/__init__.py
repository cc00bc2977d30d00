"""The trained network: what it gains over the analytic floor, on simulated people and a real capture, and what it
costs."""
