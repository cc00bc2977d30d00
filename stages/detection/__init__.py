"""Finding people and their joints in single pictures: estimators behind one interface, and the models they run."""
