"""Training of the network: scene to examples to loss to step, all of it pure."""
