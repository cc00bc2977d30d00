"""Training: scenes of the simulator become examples, examples become steps."""
