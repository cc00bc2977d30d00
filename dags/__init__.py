"""The will: which stages run, when and where."""
