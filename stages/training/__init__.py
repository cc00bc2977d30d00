<<<<<<< HEAD
"""Training: scenes of the simulator become examples, examples become steps."""
=======
"""Training of the network: scene to examples to loss to step, all of it pure."""
>>>>>>> training
