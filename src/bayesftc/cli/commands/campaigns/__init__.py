"""Commands for campaigns and their stores."""
