"""Who the people of each frame are, cut into partitions from what holds for the whole sequence."""
