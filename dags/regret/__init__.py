"""What the decisions about effects cost."""
