"""How good rendered pictures are, ours and other methods', in one protocol."""
