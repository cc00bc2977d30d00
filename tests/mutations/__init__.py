"""Whether the hard cases would notice: the lines that they guard are broken, one at a time, and each case must fail."""
