"""What several tests share: captures, archives, cameras, bodies, networks and processes with known answers."""
