"""Who is who: detections of one frame brought together over views, people followed over time, and one of them
chosen."""
