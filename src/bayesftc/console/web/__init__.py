"""The server: who may connect, commands, downloads, and the process that serves."""
