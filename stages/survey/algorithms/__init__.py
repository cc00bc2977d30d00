"""What measures of a sequence are computed with: samples of frames, joints, patches of the body, outlines, noise."""
