"""How cameras stand: turned, wrong, or moved in mid-take."""
