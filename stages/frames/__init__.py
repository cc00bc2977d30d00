"""Pictures on the project's pixel grid: decoded, cropped, undistorted, scaled, with a matte."""
