"""The paper's tables in its own form: what it prints, and beside it what was measured here."""
