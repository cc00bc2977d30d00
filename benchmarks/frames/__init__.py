"""What comes before depth: mattes without given masks, and cameras whose exposures disagree."""
