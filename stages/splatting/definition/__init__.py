"""What is drawn and how, in plain torch."""
