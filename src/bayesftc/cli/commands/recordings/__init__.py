"""Commands for recorded samples."""
