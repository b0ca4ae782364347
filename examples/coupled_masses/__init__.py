"""Two masses with a stiff spring between them, as two FMUs, with every coupling scheme."""
