"""Files and names: written whole, checked before they are followed."""
