"""One file a capture layout: folder -> `Capture`."""
