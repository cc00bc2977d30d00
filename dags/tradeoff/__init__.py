"""What quality costs in time."""
