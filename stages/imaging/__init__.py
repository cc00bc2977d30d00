"""Pictures as pixels: colour, the way between pixel grids, exposure, regions."""
