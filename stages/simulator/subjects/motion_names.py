"""Names of the motions, known without loading what computes them."""

MOTION_NAMES = ("stand", "walk", "wave", "kick", "spin", "crossed_arms", "crouch", "throw")
VALIDATION_MOTION = "throw"
"""Kept for validation: neither tuned nor trained on."""
