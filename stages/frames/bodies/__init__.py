"""Bodies in a picture, by joints alone: where they are, whose joints are whose, who stands before whom."""
