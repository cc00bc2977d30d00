"""What spoils a simulated picture, one physical effect a module; each computed only where a scene calls for it."""
