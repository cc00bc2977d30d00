"""What depth is computed with, whichever method asks: hulls, matching, sweeps, reliefs, and what bounds them."""
