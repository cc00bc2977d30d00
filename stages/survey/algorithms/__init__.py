"""What measures of a sequence are computed with: samples of frames, joints, outlines, noise."""
